"""Edges that are too long are pulled together, and nothing else moves."""

import numpy as np
import pytest

from tryon_jax.mesh.quality import edge_lengths
from tryon_jax.mesh.stretch_limit import limit_stretch, rest_edges, rest_lengths

SIDE = 12


def sheet() -> tuple[np.ndarray, np.ndarray]:
    """A square of triangles with sides of a centimetre."""
    x, y = np.meshgrid(np.arange(SIDE) * 0.01, np.arange(SIDE) * 0.01, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    i = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel()
    return points, np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])


def test_what_is_not_stretched_is_returned_as_it_is() -> None:
    points, faces = sheet()
    edges, rest = rest_edges(faces, edge_lengths(points, faces), len(points))
    assert len(edges) == 3 * SIDE**2 - 4 * SIDE + 1
    np.testing.assert_allclose(rest, np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1))
    stretched = 1.3 * points
    assert limit_stretch(stretched, edges, rest, 1.35) is stretched


@pytest.mark.parametrize("size", [0.02, 0.05])
def test_a_spike_goes_back_and_the_rest_stays(size: float) -> None:
    points, faces = sheet()
    edges, rest = rest_edges(faces, edge_lengths(points, faces), len(points))
    spiked = points.copy()
    spike = (SIDE // 2) * SIDE + SIDE // 2
    spiked[spike, 2] += size
    found = limit_stretch(spiked, edges, rest, 1.35)
    lengths = np.linalg.norm(found[edges[:, 0]] - found[edges[:, 1]], axis=1)
    assert (lengths / rest).max() < 1.36
    assert 0.0 < found[spike, 2] < size
    far = np.linalg.norm(points - points[spike], axis=1) > 0.045
    np.testing.assert_array_equal(found[far], spiked[far])


def test_a_turned_mesh_gives_a_turned_result() -> None:
    points, faces = sheet()
    rng = np.random.default_rng(0)
    edges, rest = rest_edges(faces, edge_lengths(points, faces), len(points))
    rough = points + rng.normal(size=points.shape) * 0.006
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    found = limit_stretch(rough, edges, rest, 1.35)
    np.testing.assert_allclose(limit_stretch(rough @ turn.T, edges, rest, 1.35), found @ turn.T, atol=1e-12)
    # Each pull is symmetric: the middle stays, up to the mean over a vertex's edges.
    assert np.linalg.norm(found.mean(axis=0) - rough.mean(axis=0)) < 1e-3


def test_edges_are_measured_against_the_longer_of_pattern_and_mean_drape() -> None:
    points, faces = sheet()
    uv = points[:, :2]
    lengths = rest_lengths(faces, uv, faces, points * [2.0, 0.5, 1.0])
    along, across = edge_lengths(points * [2.0, 0.5, 1.0], faces), edge_lengths(uv, faces)
    np.testing.assert_allclose(lengths, np.maximum(along, across))
    one = np.array([[0, 1, 2], [1, 0, 3]])
    edges, rest = rest_edges(one, np.array([[1.0, 2.0, 3.0], [1.5, 2.5, 3.5]]), 4)
    assert rest[(edges == [0, 1]).all(axis=1)] == 1.5, "two faces that disagree"
