"""Shape and normals of the embedded bodies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from tryon_jax.body import check_betas, face_normals, load_body, shape_body, vertex_normals
from tryon_jax.mesh.topology import inspect_topology
from tryon_jax.types import Body

BODIES = {name: load_body(name) for name in ("female", "male", "neutral")}


@pytest.fixture(params=BODIES)
def body(request: pytest.FixtureRequest) -> Body:
    return BODIES[request.param]


def test_body_is_closed_and_left_right_alike(body: Body) -> None:
    faces = np.asarray(body.faces)
    assert faces.min() == 0
    assert faces.max() == len(body.v_template) - 1
    report = inspect_topology(faces, len(body.v_template))
    assert (report.euler, report.loops, report.components) == (2, 0, 1)
    assert (report.non_manifold_edges, report.non_manifold_vertices, report.unused_vertices) == (0, 0, 0)
    assert report.consistently_oriented
    mirrored = np.asarray(body.v_template) * np.array([-1, 1, 1])
    distance, _ = cKDTree(np.asarray(body.v_template)).query(mirrored)
    assert distance.max() < 1e-6


def test_weights_and_regressor_are_averages(body: Body) -> None:
    for rows in (body.lbs_weights, body.J_regressor):
        rows = np.asarray(rows)
        assert rows.min() >= 0
        np.testing.assert_allclose(rows.sum(1), 1, atol=1e-5)
    assert body.parents[0] == -1
    assert all(parent < joint for joint, parent in enumerate(body.parents))


@given(betas=st.lists(st.floats(-3, 3, width=32), min_size=10, max_size=10))
def test_pelvis_stays_on_the_origin(betas: list[float]) -> None:
    for body in BODIES.values():
        _, joints = shape_body(body, jnp.asarray(betas, jnp.float32))
        assert float(jnp.abs(joints[0]).max()) < 1e-6


def test_missing_betas_are_zeros_and_batches_are_vmap(body: Body) -> None:
    short = jnp.asarray([1.0, -2.0])
    full = jnp.zeros(10).at[:2].set(short)
    np.testing.assert_allclose(shape_body(body, short)[0], shape_body(body, full)[0], atol=1e-7)
    many, joints = jax.jit(jax.vmap(shape_body, in_axes=(None, 0)))(body, jnp.stack([full, 2 * full]))
    assert joints.shape == (2, 24, 3)
    np.testing.assert_allclose(many[1], shape_body(body, 2 * full)[0], atol=1e-6)


def test_first_beta_is_stature_and_adults_are_adult(body: Body) -> None:
    heights = [float(jnp.ptp(shape_body(body, jnp.asarray([value]))[0][:, 1])) for value in (-2.0, 0.0, 2.0)]
    assert 1.45 < heights[0] < heights[1] < heights[2] < 2.0


def test_normals_point_outward_and_zero_areas_stay_finite(body: Body) -> None:
    vertices, _ = shape_body(body, jnp.zeros(10))
    normals = vertex_normals(vertices, body.faces)
    np.testing.assert_allclose(jnp.linalg.norm(normals, axis=1), 1, atol=1e-5)
    corners = vertices[body.faces]
    area = jnp.linalg.norm(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    volume = jnp.sum(area * jnp.sum(face_normals(vertices, body.faces) * corners.mean(1), axis=1)) / 3
    assert 0.05 < float(volume) < 0.12
    flat = jnp.zeros((3, 3))
    one = jnp.asarray([[0, 1, 2]])
    assert float(jnp.abs(face_normals(flat, one)).max()) == 0
    assert bool(jnp.isfinite(jax.grad(lambda x: vertex_normals(x, one).sum())(flat)).all())


def test_normals_of_a_tetrahedron_are_exact(x64: None) -> None:
    vertices = jnp.asarray([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = jnp.asarray([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    expected = np.array([[0, 0, -1], [0, -1, 0], [-1, 0, 0], np.ones(3) / np.sqrt(3)])
    np.testing.assert_allclose(face_normals(vertices, faces), expected, atol=1e-15)
    np.testing.assert_allclose(vertex_normals(vertices, faces)[0], -np.ones(3) / np.sqrt(3), atol=1e-15)


def test_bad_betas_and_names_are_refused() -> None:
    body = BODIES["female"]
    with pytest.raises(ValueError, match=r"0 to 10 numbers.*female"):
        shape_body(body, jnp.zeros(11))
    with pytest.raises(ValueError, match=r"entry \(1,\) is nan"):
        check_betas(body, [0.0, float("nan")])
    with pytest.raises(ValueError, match=r"0 to 10 numbers.*\(12,\)"):
        check_betas(body, np.zeros(12))
    with pytest.raises(ValueError, match="beta 2 = -50 is outside its range -5 to 5 standard deviations"):
        check_betas(body, [0.0, -50.0])
    with pytest.raises(ValueError, match="did you mean 'female'"):
        load_body("femal")
