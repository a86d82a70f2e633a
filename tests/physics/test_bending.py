"""Bending: against derivatives, the table, and the reference implementation where both choose alike."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import make_cloth, make_fabric, place, sheet, wavy
from hypothesis import given
from hypothesis import strategies as st

from tryon_jax.physics.bending import bending_energy, bending_force, dihedral_angles, hinge_roots, hinge_stiffness
from tryon_jax.physics.fabrics import load_fabric


def folded(angle: float, turn: float = 0.0) -> tuple:
    """Two right triangles of 2 cm that share an edge along the warp turned by `turn`, folded by `angle`."""
    uv = 0.02 * np.array([[0.0, 0], [1, 0], [0.5, 1], [0.5, -1]])
    cos, sin = np.cos(turn), np.sin(turn)
    grain = uv @ np.array([[cos, sin], [-sin, cos]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    points = np.concatenate([uv, np.zeros((4, 1))], axis=1)
    points[3] = [0.01, -0.02 * np.cos(angle), -0.02 * np.sin(angle)]
    cloth = make_cloth(faces, grain)
    return cloth, place(points, cloth)


@pytest.mark.parametrize("angle", [-3.0, -1.0, -1e-4, 0.0, 0.3, 1.5, 3.0])
def test_dihedral_angle_of_a_fold(x64: None, angle: float) -> None:
    cloth, x = folded(angle)
    theta, _ = dihedral_angles(x, cloth)
    assert float(theta[0]) == pytest.approx(angle, abs=1e-9)


def test_gradient_of_the_angle(x64: None) -> None:
    faces, uv = sheet(4, 3, 0.08, 0.06)
    cloth = make_cloth(faces, uv)
    x = place(wavy(uv, 0, scale=0.3), cloth)
    _, gradient = dihedral_angles(x, cloth)
    numeric = np.asarray(jax.jacfwd(lambda y: dihedral_angles(y, cloth)[0])(x))
    hinges = np.asarray(cloth.hinges)
    count = int((np.asarray(cloth.hinge_shape) > 0).sum())
    for corner in range(4):
        mine = np.asarray(gradient)[:count, corner]
        np.testing.assert_allclose(mine, numeric[np.arange(count), hinges[:count, corner]], rtol=1e-6, atol=1e-6)


def test_stiffness_reads_the_table(x64: None) -> None:
    table = np.asarray(load_fabric("gray-interlock").bending)
    fabric = load_fabric("gray-interlock")
    for row, turn in enumerate((0.0, np.pi / 4, np.pi / 2)):
        cloth, _ = folded(0.0, turn)
        scale = float(cloth.hinge_curvature[0])
        assert scale == pytest.approx(0.02 / (2 * 0.0004), rel=1e-9)
        for column, curvature in enumerate((0.0, 5.0, 10.0, 15.0, 20.0)):
            for sign in (-1, 1):
                theta = jnp.full(cloth.hinge_shape.shape, sign * curvature / scale)
                assert float(hinge_stiffness(theta, cloth, fabric)[0]) == pytest.approx(table[row, column], rel=1e-4)
        # Beyond the last column, and half way between two.
        far = jnp.full(cloth.hinge_shape.shape, 100.0 / scale)
        assert float(hinge_stiffness(far, cloth, fabric)[0]) == pytest.approx(table[row, 4], rel=1e-4)
        between = jnp.full(cloth.hinge_shape.shape, 7.5 / scale)
        middle = table[row, 1:3].mean()
        assert float(hinge_stiffness(between, cloth, fabric)[0]) == pytest.approx(middle, rel=1e-6)


def test_the_softer_side_counts(x64: None) -> None:
    """Across a seam the two sides may have different grain: the hinge is as stiff as the softer one."""
    cloth, _ = folded(0.0)
    both = np.array(cloth.hinge_grain)
    both[0] = [0.0, np.pi / 2]
    mixed = type(cloth)(
        **{**{name: getattr(cloth, name) for name in cloth.__dataclass_fields__}, "hinge_grain": jnp.asarray(both)}
    )
    table = np.asarray(load_fabric("gray-interlock").bending)
    value = hinge_stiffness(jnp.zeros(cloth.hinge_shape.shape), mixed, load_fabric("gray-interlock"))[0]
    assert float(value) == pytest.approx(min(table[0, 0], table[2, 0]), rel=1e-5)


def test_energy_of_one_hinge(x64: None) -> None:
    cloth, x = folded(0.4)
    # k l² θ² / (8 (A0 + A1))
    expected = 3e-5 * 0.02**2 * 0.4**2 / (8 * 0.0004)
    assert float(bending_energy(x, cloth, make_fabric(bending=3e-5))) == pytest.approx(expected, rel=1e-9)


def test_force_is_the_energys_gradient_and_bears_no_net_load(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, fabric = make_cloth(faces, uv), load_fabric("gray-interlock")
    x = place(wavy(uv, 2, scale=0.3), cloth)
    force = bending_force(x, cloth, fabric)
    np.testing.assert_allclose(force, -jax.grad(bending_energy)(x, cloth, fabric), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(force.sum(0), 0, atol=1e-12)
    np.testing.assert_allclose(jnp.cross(x, force).sum(0), 0, atol=1e-12)
    assert not np.asarray(force)[len(uv) :].any()


jitted_force = jax.jit(bending_force)


@given(seed=st.integers(0, 10**6))
def test_a_turned_cloth_has_turned_forces(seed: int) -> None:
    with jax.enable_x64(True):
        rng = np.random.default_rng(seed)
        rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        rotation *= np.sign(np.linalg.det(rotation))
        faces, uv = sheet(4, 3, 0.08, 0.06)
        cloth, fabric = make_cloth(faces, uv), load_fabric("gray-interlock")
        points = wavy(uv, seed, scale=0.3)
        force = np.asarray(jitted_force(place(points, cloth), cloth, fabric))
        again = np.asarray(jitted_force(place(points @ rotation.T + rng.normal(size=3), cloth), cloth, fabric))
        np.testing.assert_allclose(again, force @ rotation.T, atol=1e-8 * np.abs(force).max())


def test_both_ways_of_folding_cost_the_same(x64: None) -> None:
    fabric = load_fabric("gray-interlock")
    forces = [np.asarray(bending_force(*reversed(folded(sign * 0.5)), fabric)) for sign in (1, -1)]
    np.testing.assert_allclose(forces[0] * [1, 1, -1], forces[1], rtol=1e-9, atol=1e-15)


def test_nodal_force_equals_the_reference(x64: None) -> None:
    """ARCSim 0.2.1, gray-interlock: faces around a corner of a noisy patch, folded to the side where both agree."""
    faces = np.array([[0, 1, 3], [1, 4, 3], [1, 2, 5], [1, 5, 4]])
    uv = np.array(
        [
            [0.061484335876, 0.08120367421],
            [0.081507573845, 0.079111371392],
            [0.1, 0.08],
            [0.06, 0.1],
            [0.08, 0.1],
            [0.1, 0.1],
        ]
    )
    points = np.array(
        [
            [0.0676095062547, 0.0808092874435, 0.0012610341561],
            [0.088771369417, 0.0791592954409, -0.000236863366],
            [0.1084, 0.0804, -0.0015136049906],
            [0.0666, 0.0992, 0.0013509263611],
            [0.0878, 0.0996, -0.0001167482869],
            [0.109, 0.1, -0.0015136049906],
        ]
    )
    index = 4
    expected = np.array([-1.1278976270987656e-07, 4.275429672116929e-09, -1.6397052086504408e-06])
    cloth = make_cloth(faces, uv)
    x = place(points, cloth)
    count = int((np.asarray(cloth.hinge_shape) > 0).sum())
    assert (np.asarray(dihedral_angles(x, cloth)[0])[:count] < 0).all()
    force = bending_force(x, cloth, load_fabric("gray-interlock"))
    np.testing.assert_allclose(force[index], expected, rtol=1e-6)


def test_tangent_is_above_gauss_newton(x64: None) -> None:
    """The blocks leave out the pair that shares no edge; what replaces it must not be softer."""
    faces, uv = sheet(4, 3, 0.08, 0.06)
    cloth, fabric = make_cloth(faces, uv), load_fabric("gray-interlock")
    x = place(wavy(uv, 5, scale=0.3), cloth)
    theta, gradient = dihedral_angles(x, cloth)
    weight = hinge_stiffness(theta, cloth, fabric) * cloth.hinge_shape
    count = int((np.asarray(cloth.hinge_shape) > 0).sum())
    roots = np.asarray(hinge_roots(weight, gradient)).transpose(2, 1, 0)[:count]
    blocks = np.einsum("hic,hjd->hicjd", roots, roots)
    blocks[:, 2, :, 3] = blocks[:, 3, :, 2] = 0
    blocks[:, 2, :, 2] *= 2
    blocks[:, 3, :, 3] *= 2
    dense = blocks.reshape(count, 12, 12)
    flat = np.asarray(gradient)[:count].reshape(count, 12)
    newton = np.asarray(weight)[:count, None, None] * flat[:, :, None] * flat[:, None, :]
    np.testing.assert_allclose(dense, dense.transpose(0, 2, 1), rtol=1e-12)
    size = np.abs(dense).max(axis=(1, 2))
    assert (np.linalg.eigvalsh(dense).min(axis=1) >= -1e-12 * size).all()
    assert (np.linalg.eigvalsh(dense - newton).min(axis=1) >= -1e-12 * size).all()
