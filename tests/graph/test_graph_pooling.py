"""Down- and upsampling matrices: rows, copies, barycentric exactness."""

import numpy as np
import pytest
from hypothesis import given

from tests.graph_meshes import meshes, triangle, tube
from tryon_jax.graph.coarsen import coarsen
from tryon_jax.graph.pooling import down_matrix, up_matrix


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


def test_level_without_triangles_copies_its_clusters():
    vertices, faces = triangle()
    up = up_matrix(vertices, vertices, np.zeros((0, 3), np.int64), np.arange(3))
    np.testing.assert_array_equal(up.toarray(), np.eye(3))
    assert len(faces) == 1
