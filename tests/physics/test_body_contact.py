"""Contact pressure and friction, apart from the solver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from cloth_scenes import horizontal, make_cloth, make_fabric, place, sheet, slab, start

from tryon_jax.contact.surface import build_surface
from tryon_jax.physics.body_contact import (
    SLIDING,
    ContactLaw,
    contact_forces,
    friction,
    normal_gradient,
    normal_hessian,
    pressure,
    sample_points,
)

LAW = ContactLaw()
THICKNESS = jnp.asarray(0.004)
contact_at = jax.jit(contact_forces)


def test_pressure_law(x64: None) -> None:
    approach = jnp.asarray([-1.0, -1e-9, 0.0, 1e-6, 0.001, 0.002, 0.004, 0.006, 0.05])
    value, slope = pressure(approach, jnp.asarray(0.004), LAW)
    assert not np.asarray(value)[:3].any()
    assert not np.asarray(slope)[:3].any()
    assert (np.diff(np.asarray(value)[2:]) > 0).all()
    # soft · a + hard · a³ / (3 t²) up to the skin, linear beyond it.
    np.testing.assert_allclose(value[4], 1e5 * 0.001 + 1e7 * 0.001**3 / (3 * 0.004**2), rtol=1e-12)
    at_skin = 1e5 * 0.004 + 1e7 * 0.004 / 3
    np.testing.assert_allclose(value[6], at_skin, rtol=1e-12)
    np.testing.assert_allclose(value[8], at_skin + (1e5 + 1e7) * 0.046, rtol=1e-12)


def test_pressure_is_continuous_and_its_slope_is_its_derivative(x64: None) -> None:
    t = float(THICKNESS)
    thickness = jnp.asarray(t)
    for at in (1e-4, 0.3 * t, 0.999 * t, 1.001 * t, 2 * t):
        low, high = (float(pressure(jnp.asarray([at + d]), thickness, LAW)[0][0]) for d in (-1e-8, 1e-8))
        slope = float(pressure(jnp.asarray([at]), thickness, LAW)[1][0])
        assert (high - low) / 2e-8 == pytest.approx(slope, rel=1e-6)
    for edge in (0.0, t):
        below, above = (pressure(jnp.asarray([edge + d]), thickness, LAW) for d in (-1e-12, 1e-12))
        assert float(above[0][0]) == pytest.approx(float(below[0][0]), abs=1e-4)
        if edge:
            assert float(above[1][0]) == pytest.approx(float(below[1][0]), rel=1e-6)


def resting(height: float, points: np.ndarray | None = None) -> tuple:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface, fabric = make_cloth(faces, uv), slab(), make_fabric()
    x = place(horizontal(uv, height) if points is None else points, cloth)
    state = start(x, cloth, surface)
    return cloth, fabric, x, state, contact_at(x, state.face, cloth, fabric, surface, LAW, 0.0), uv


def test_a_flat_sheet_carries_pressure_times_area(x64: None) -> None:
    cloth, _, _, _, contact, uv = resting(0.003)
    expected = float(pressure(jnp.asarray([0.001]), jnp.asarray(0.004), LAW)[0][0]) * 0.1 * 0.08
    gradient = np.asarray(normal_gradient(contact, cloth))
    np.testing.assert_allclose(-gradient.sum(axis=0), [0, expected, 0], atol=1e-9)
    assert float(contact.load.sum()) == pytest.approx(expected)
    np.testing.assert_allclose(contact.point.height[: len(uv)], 0.003, atol=1e-12)
    # Above the thickness there is nothing.
    _, _, _, _, nothing, _ = resting(0.0041)
    assert not np.asarray(nothing.force).any()


def test_gradient_and_stiffness_by_finite_differences(x64: None) -> None:
    """On a plane the normal does not turn, so the blocks are the whole tangent (without margin)."""
    _, uv = sheet(5, 4, 0.1, 0.08)
    points = horizontal(uv, 0.001) + 0.001 * np.random.default_rng(0).normal(size=(len(uv), 3))
    cloth, fabric, x, state, contact, _ = resting(0, points)
    surface = slab()
    at_vertices, at_faces = normal_hessian(contact, cloth)
    matrix = np.zeros((64, 64, 3, 3))
    matrix[np.arange(64), np.arange(64)] += np.asarray(at_vertices)
    for face, block in zip(np.asarray(cloth.faces), np.asarray(at_faces), strict=True):
        for i in face:
            for j in face:
                matrix[i, j] += block
    for vertex, axis in ((0, 1), (7, 1), (13, 0), (20, 1)):
        delta = jnp.zeros_like(x).at[vertex, axis].set(1e-8)
        sides = [
            np.asarray(normal_gradient(contact_at(x + d, state.face, cloth, fabric, surface, LAW, 0.0), cloth))
            for d in (delta, -delta)
        ]
        np.testing.assert_allclose((sides[0] - sides[1]) / 2e-8, matrix[:, vertex, :, axis], atol=1e-3, rtol=1e-5)


def test_samples_are_vertices_and_face_centres(x64: None) -> None:
    faces, uv = sheet(2, 2, 0.04, 0.04)
    cloth = make_cloth(faces, uv)
    points = horizontal(uv)
    samples = np.asarray(sample_points(place(points, cloth), cloth))
    np.testing.assert_allclose(samples[: len(uv)], points)
    np.testing.assert_allclose(samples[64 : 64 + len(faces)], points[faces].mean(axis=1))


def test_a_face_whose_vertices_are_outside_is_held_off_by_its_centre(x64: None) -> None:
    """A coarse face over a ridge: only the centre touches."""

    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    surface = build_surface(np.asarray(ball.vertices), np.asarray(ball.faces))
    uv = np.array([[-0.06, -0.04], [0.06, -0.04], [0.0, 0.08]])
    cloth = make_cloth(np.array([[0, 1, 2]]), uv)
    x = place(np.stack([uv[:, 0], np.full(3, 0.049), -uv[:, 1]], axis=1), cloth)
    contact = contact_at(x, start(x, cloth, surface).face, cloth, make_fabric(), surface, LAW, 0.0)
    assert (np.asarray(contact.point.height)[:3] > 0.01).all()
    assert float(contact.point.height[64]) < 0
    gradient = np.asarray(normal_gradient(contact, cloth))[:3]
    assert (gradient[:, 1] < -1e-3).all()


def test_friction_spring_and_its_cap(x64: None) -> None:
    cloth, fabric, x, _, contact, uv = resting(0.003)
    count = len(uv)
    spring = LAW.tangential * np.asarray(cloth.vertex_areas)[:count]
    limit = 0.3 * np.asarray(contact.load)[:count] / spring
    slip = np.zeros(x.shape)
    slip[:count, 0] = 0.5 * limit
    slip[:count, 1] = 7.0
    slip[1, 0] = 4 * limit[1]
    kept, stiffness, tangent = friction(jnp.asarray(slip), contact, cloth, fabric, LAW)
    kept = np.asarray(kept)[:count]
    np.testing.assert_allclose(kept[:, 1], 0, atol=1e-12)
    np.testing.assert_allclose(np.delete(kept[:, 0], 1), np.delete(0.5 * limit, 1), rtol=1e-9)
    assert kept[1, 0] == pytest.approx(limit[1])
    stiffness = np.asarray(stiffness)[:count]
    np.testing.assert_allclose(np.delete(stiffness / spring, 1), 1.0)
    assert stiffness[1] / spring[1] == pytest.approx(SLIDING)
    np.testing.assert_allclose(tangent[:count], np.tile(np.diag([1.0, 0, 1]), (count, 1, 1)), atol=1e-12)


def test_no_load_no_friction(x64: None) -> None:
    cloth, fabric, x, _, contact, _ = resting(0.01)
    kept, stiffness, _ = friction(jnp.ones_like(x), contact, cloth, fabric, LAW)
    assert np.abs(np.asarray(kept)).max() < 1e-9
    assert not np.asarray(stiffness).any()
