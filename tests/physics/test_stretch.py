"""In-plane elasticity: against the tables, against derivatives, and against the reference implementation."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import make_cloth, make_fabric, place, sheet, wavy
from hypothesis import given
from hypothesis import strategies as st

from tryon_jax.physics.fabrics import GRID, GRID_LOW, load_fabric
from tryon_jax.physics.stretch import (
    deformation_gradients,
    face_hessian,
    green_strain,
    principal_stretches,
    stiffness,
    stiffness_and_slope,
    stress,
    stretch_energy,
    stretch_force,
)

# Stiffness read by ARCSim 0.2.1 for gray-interlock: G00, G11, G01 and k0, k1, k2, k3 (N/m).
ARCSIM_STIFFNESS = np.array(
    [
        [0, 0, 0, 41.6374194, 0, 109.839785, 66.8907874],
        [0.00779976602, -0.0108558923, 0.018498374, 53.3010632, 9.57429041, 146.065396, 67.7139711],
        [0.00887397337, -0.00855194663, 0.00707164719, 45.0641622, 4.09656852, 124.25629, 65.0036916],
        [0.221994013, -0.140758044, -0.00784651146, 93.048491, 111.092593, 516.05836, 0],
        [0.0388044623, 0.0802808322, -0.197030718, 252.171952, 201.923749, 744.645368, 31.5797284],
    ]
)


def test_stiffness_equals_the_reference(x64: None) -> None:
    strain = jnp.asarray(ARCSIM_STIFFNESS[:, :3] * [1, 1, 2])
    np.testing.assert_allclose(
        stiffness(strain, load_fabric("gray-interlock")), ARCSIM_STIFFNESS[:, 3:], rtol=2e-6, atol=1e-3
    )


def test_nodal_force_equals_the_reference(x64: None) -> None:
    # ARCSim 0.2.1, gray-interlock: a vertex and its neighbours out of a noisy patch, and the force on it (N).
    faces = np.array([[1, 2, 0], [1, 0, 4], [2, 3, 0], [3, 5, 0], [4, 0, 6], [0, 7, 6], [0, 5, 8], [0, 8, 7]])
    uv = np.array(
        [
            [0.042526828433, 0.036021908001],
            [0.021095693499, 0.01815829371],
            [0.036327788191, 0.016132221084],
            [0.062506161914, 0.023302044618],
            [0.020348999932, 0.04348057939],
            [0.062859234213, 0.036268684602],
            [0.022905431379, 0.060331689762],
            [0.038397695124, 0.05938149777],
            [0.056226557369, 0.056994266212],
        ]
    )
    points = np.array(
        [
            [0.0434378341146, 0.0353616925164, -0.0003307640109],
            [0.0214239309661, 0.0175141129782, 0.0001975610301],
            [0.0365427200389, 0.0164802424462, -0.0005920589834],
            [0.0621753106276, 0.0230838269947, -0.0005849009539],
            [0.0206908430271, 0.0439825601782, -0.0003089535224],
            [0.0633267592068, 0.0362932119094, 0.0010011962918],
            [0.023749985105, 0.0601879959081, 0.0007872041394],
            [0.0381813022007, 0.0590137561234, 0.0001248926858],
            [0.0567422839116, 0.0570747710004, -0.0002927644121],
        ]
    )
    expected = np.array([-0.1411528695952383, 0.18487274503441323, 0.0036674801750928446])
    cloth = make_cloth(faces, uv)
    force = stretch_force(place(points, cloth), cloth, load_fabric("gray-interlock"))
    np.testing.assert_allclose(force[0], expected, rtol=2e-6)


@pytest.mark.parametrize(
    ("low", "high", "row", "measured"),
    [(7, 14, 1, (0, 1)), (8, 29, 1, (0, 1)), (7, 14, 5, (2, 1)), (8, 29, 5, (2, 1))],
)
def test_uniaxial_stretch_reproduces_the_table(
    x64: None, low: int, high: int, row: int, measured: tuple[int, int]
) -> None:
    """Stretched beyond 1/6 along warp or weft at nodes of the table, the pull is that of the measured row."""
    from test_fabrics import SOURCE

    faces, uv = sheet(3, 2, 0.06, 0.04)
    cloth = make_cloth(faces, uv)
    strains = np.array([GRID_LOW + high / GRID, GRID_LOW + low / GRID])
    strains = strains if row == 1 else np.array([GRID_LOW + low / GRID, GRID_LOW + high / GRID])
    scale = np.sqrt(1 + 2 * strains)
    points = np.concatenate([uv * scale, np.zeros((len(uv), 1))], axis=1)
    force = np.asarray(stretch_force(place(points, cloth), cloth, load_fabric("gray-interlock")))
    axis = 0 if row == 1 else 1
    end = uv[:, axis] > uv[:, axis].max() - 1e-9
    pull = -force[: len(uv)][end, axis].sum() / (0.04 if row == 1 else 0.06)
    k = 2 * np.array(SOURCE["gray-interlock"]["stretching"])[row]
    axial, coupling = k[measured[0]], k[measured[1]]
    expected = scale[axis] * (axial * strains[axis] + coupling * strains[1 - axis])
    assert pull == pytest.approx(expected, rel=2e-6)


def test_force_is_the_energys_gradient_and_bears_no_net_load(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, fabric = make_cloth(faces, uv), load_fabric("white-dots-on-blk")
    x = place(wavy(uv, 0), cloth)
    force = stretch_force(x, cloth, fabric)
    np.testing.assert_allclose(force, -jax.grad(stretch_energy)(x, cloth, fabric), rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(force.sum(0), 0, atol=1e-9)
    np.testing.assert_allclose(jnp.cross(x, force).sum(0), 0, atol=1e-9)
    assert not np.asarray(force)[len(uv) :].any()


def test_force_by_finite_differences_of_a_linear_fabrics_energy(x64: None) -> None:
    faces, uv = sheet(3, 3, 0.06, 0.06)
    cloth, fabric = make_cloth(faces, uv), make_fabric(warp=100, coupling=30, weft=70, shear=40)
    x = place(wavy(uv, 1), cloth)
    force = np.asarray(stretch_force(x, cloth, fabric))
    for vertex, axis in ((0, 0), (5, 1), (10, 2), (15, 0)):
        delta = jnp.zeros_like(x).at[vertex, axis].set(1e-6)
        change = stretch_energy(x + delta, cloth, fabric) - stretch_energy(x - delta, cloth, fabric)
        assert -float(change) / 2e-6 == pytest.approx(force[vertex, axis], rel=1e-6)


@given(seed=st.integers(0, 10**6))
def test_a_turned_cloth_has_turned_forces(seed: int) -> None:
    with jax.enable_x64(True):
        rng = np.random.default_rng(seed)
        rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        rotation *= np.sign(np.linalg.det(rotation))
        faces, uv = sheet(4, 3, 0.08, 0.06)
        cloth, fabric = make_cloth(faces, uv), load_fabric("gray-interlock")
        points = wavy(uv, seed)
        moved = points @ rotation.T + rng.normal(size=3)
        force = jitted_force(place(points, cloth), cloth, fabric)
        again = jitted_force(place(moved, cloth), cloth, fabric)
        scale = np.abs(np.asarray(force)).max()
        np.testing.assert_allclose(np.asarray(again), np.asarray(force) @ rotation.T, atol=1e-9 * scale)


jitted_force = jax.jit(stretch_force)


def test_flat_cloth_anywhere_is_at_rest(x64: None) -> None:
    faces, uv = sheet(4, 3, 0.08, 0.06)
    cloth, fabric = make_cloth(faces, uv), load_fabric("gray-interlock")
    points = wavy(uv, 3, scale=0.0)
    assert np.abs(stretch_force(place(points, cloth), cloth, fabric)).max() < 1e-12
    np.testing.assert_allclose(principal_stretches(place(points, cloth), cloth)[: len(faces)], 1, atol=1e-9)


def test_principal_stretches_are_singular_values(x64: None) -> None:
    faces, uv = sheet(4, 3, 0.08, 0.06)
    cloth = make_cloth(faces, uv)
    x = place(wavy(uv, 4, scale=0.3), cloth)
    singular = np.linalg.svd(np.asarray(deformation_gradients(x, cloth)), compute_uv=False)
    np.testing.assert_allclose(principal_stretches(x, cloth)[: len(faces)], singular[: len(faces)], rtol=1e-6)


def test_slope_is_the_derivative_inside_a_cell(x64: None) -> None:
    rng = np.random.default_rng(0)
    # Centres of cells, both signs of shear.
    cell = rng.integers(1, GRID - 2, size=(40, 3)) + rng.uniform(0.2, 0.8, size=(40, 3))
    strain = cell / GRID + [GRID_LOW, GRID_LOW, 0]
    strain[:, 2] *= 2 * rng.choice([-1, 1], size=40)
    strain = jnp.asarray(strain)
    fabric = load_fabric("11oz-black-denim")
    _, slope = stiffness_and_slope(strain, fabric)
    for axis in range(3):
        delta = jnp.zeros((1, 3)).at[0, axis].set(1e-6)
        numeric = (stiffness(strain + delta, fabric) - stiffness(strain - delta, fabric)) / 2e-6
        np.testing.assert_allclose(slope[:, :, axis], numeric, rtol=1e-5, atol=1e-3)


def strained_faces(seed: int) -> tuple:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth = make_cloth(faces, uv)
    return cloth, place(wavy(uv, seed, scale=0.12), cloth), len(faces)


def as_matrices(sides: jax.Array) -> np.ndarray:
    """The blocks [corner, corner, xyz, xyz] of each face from those of its sides."""
    blocks = np.zeros((sides.shape[3], 3, 3, 3, 3))
    for side, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        block = np.asarray(sides)[:, :, side].transpose(2, 0, 1)
        blocks[:, i, j], blocks[:, j, i] = block, block.transpose(0, 2, 1)
        blocks[:, i, i] -= block
        blocks[:, j, j] -= block.transpose(0, 2, 1)
    return blocks


@pytest.mark.parametrize("name", ["gray-interlock", "white-dots-on-blk", "navy-sparkle-sweat"])
def test_tangent_is_symmetric_and_positive(x64: None, name: str) -> None:
    cloth, x, count = strained_faces(5)
    fabric = load_fabric(name)
    gradients = deformation_gradients(x, cloth)
    strain = green_strain(gradients)
    blocks = as_matrices(face_hessian(gradients, strain, stress(strain, fabric), cloth, fabric))[:count]
    blocks = blocks.transpose(0, 1, 3, 2, 4).reshape(count, 9, 9)
    np.testing.assert_allclose(blocks, blocks.transpose(0, 2, 1), atol=1e-9 * np.abs(blocks).max())
    eigenvalues = np.linalg.eigvalsh(blocks)
    assert eigenvalues.min() > -1e-9 * eigenvalues.max()


def test_tangent_bounds_the_true_one_from_above(x64: None) -> None:
    """The solver's convergence rests on it: never softer than the symmetric part of the force's derivative."""
    cloth, x, count = strained_faces(6)
    derivative = jax.jit(jax.jacfwd(stretch_force))
    measured = [replace(load_fabric(name), name="linear") for name in ("gray-interlock", "white-dots-on-blk")]
    for fabric in (make_fabric(warp=100, coupling=30, weft=70, shear=40), *measured):
        true = -np.asarray(derivative(x, cloth, fabric)).reshape(192, 192)
        gradients = deformation_gradients(x, cloth)
        strain = green_strain(gradients)
        blocks = as_matrices(face_hessian(gradients, strain, stress(strain, fabric), cloth, fabric))
        ours = np.zeros((64, 64, 3, 3))
        for face, block in zip(np.asarray(cloth.faces)[:count], blocks, strict=False):
            ours[np.ix_(face, face)] += block
        ours = ours.transpose(0, 2, 1, 3).reshape(192, 192)
        gap = np.linalg.eigvalsh(ours - 0.5 * (true + true.T))
        assert gap.min() > -1e-6 * np.abs(ours).max()
