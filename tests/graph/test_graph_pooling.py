"""Down- and upsampling matrices: rows, copies, barycentric exactness."""

import numpy as np
import pytest
from hypothesis import given

from tests.graph_meshes import meshes, triangle, tube
from tryon_jax.graph.coarsen import coarsen
from tryon_jax.graph.pooling import barycentric_of_closest, closest_on_triangles, down_matrix, up_matrix


@given(meshes())
def test_rows_are_averages(mesh):
    vertices, faces = mesh
    coarse = coarsen(vertices, faces)
    for pooling in ("average", "select"):
        down = down_matrix(coarse, pooling)
        up = up_matrix(vertices, down @ vertices, coarse.faces, coarse.cluster)
        assert down.shape == up.shape[::-1] == (len(coarse.kept), len(vertices))
        for matrix in (down, up):
            assert matrix.data.min() > 0
            np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-12)
        assert np.diff(up.indptr).max() <= 3


def test_selection_then_interpolation_is_exact_at_kept_vertices():
    vertices, faces = tube()
    coarse = coarsen(vertices, faces)
    down = down_matrix(coarse, "select")
    up = up_matrix(vertices, down @ vertices, coarse.faces, coarse.cluster)
    np.testing.assert_allclose((down @ up).toarray(), np.eye(len(coarse.kept)), atol=1e-9)


@pytest.mark.parametrize(("pooling", "limit"), [("average", 0.12), ("select", 0.08)])
def test_round_trip_keeps_the_shape(pooling, limit):
    vertices, faces = tube(24, 30)
    edge = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1).mean()
    coarse = coarsen(vertices, faces)
    down = down_matrix(coarse, pooling)
    up = up_matrix(vertices, down @ vertices, coarse.faces, coarse.cluster)
    error = np.linalg.norm(up @ (down @ vertices) - vertices, axis=1)
    assert np.sqrt((error**2).mean()) < limit * 2 * edge


def test_closest_point_against_a_dense_search():
    vertices, faces = tube(8, 9)
    points = np.random.default_rng(1).uniform(-0.35, 0.35, (40, 3))
    face, weights = closest_on_triangles(points, vertices, faces)
    found = np.einsum("nk,nkc->nc", weights, vertices[faces[face]])
    # All points of all triangles on a fine grid of barycentric weights.
    steps = np.linspace(0, 1, 41)
    grid = np.array([(1 - a - b, a, b) for a in steps for b in steps if a + b <= 1 + 1e-12])
    samples = np.einsum("gk,fkc->fgc", grid, vertices[faces]).reshape(-1, 3)
    nearest = np.sqrt(((points[:, None] - samples[None]) ** 2).sum(-1).min(axis=1))
    distance = np.linalg.norm(found - points, axis=1)
    assert (distance <= nearest + 1e-9).mean() > 0.95
    assert (distance >= nearest - 0.005).all()
    assert weights.min() >= -1e-12


def test_closest_point_regions_of_one_triangle():
    a, b, c = np.eye(3)[[0, 1]].tolist() + [[0.0, 0.0, 0.0]]
    corners = np.array([c, a, b])
    cases = {
        (-1.0, -1.0, 0.5): (1, 0, 0),
        (2.0, 0.0, -1.0): (0, 1, 0),
        (0.0, 3.0, 0.0): (0, 0, 1),
        (0.25, -1.0, 0.0): (0.75, 0.25, 0),
        (1.0, 1.0, 0.0): (0, 0.5, 0.5),
        (0.2, 0.3, 9.0): (0.5, 0.2, 0.3),
    }
    points = np.array(list(cases))
    weights = barycentric_of_closest(points, *(np.broadcast_to(v, points.shape) for v in corners))
    np.testing.assert_allclose(weights, list(cases.values()), atol=1e-12)


def test_closest_point_on_a_triangle_without_area_is_on_its_longest_edge():
    flat = np.array([[0.0, 0, 0], [0.5, 0, 0], [1, 0, 0]])
    weights = barycentric_of_closest(np.array([[0.7, 1.0, 0]]), *(v[None] for v in flat))
    np.testing.assert_allclose(weights @ flat, [[0.7, 0, 0]], atol=1e-12)


def test_level_without_triangles_copies_its_clusters():
    vertices, faces = triangle()
    up = up_matrix(vertices, vertices, np.zeros((0, 3), np.int64), np.arange(3))
    np.testing.assert_array_equal(up.toarray(), np.eye(3))
    assert len(faces) == 1
