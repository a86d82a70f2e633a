"""Closest points on triangles and meshes, against other implementations and by hand."""

import igl
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from graph_meshes import tube
from hypothesis import given
from hypothesis import strategies as st

from tryon_jax.contact.closest_points import closest_point_on_triangle
from tryon_jax.mesh import closest_points
from tryon_jax.mesh.closest_points import MeshSearch, _parts
from tryon_jax.mesh.triangles import Triangles


def weights_on(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Weights of the closest point of triangle k to point k."""
    _, v, w = Triangles(triangles).closest(points, np.arange(len(points)))
    return np.stack([1 - v - w, v, w], axis=1)


@given(seed=st.integers(0, 10**6), flatness=st.sampled_from([1.0, 0.1, 1e-3]))
def test_host_and_device_and_trimesh_agree(seed: int, flatness: float) -> None:
    rng = np.random.default_rng(seed)
    triangles = rng.normal(size=(64, 3, 3))
    triangles[:, 2] = triangles[:, 0] + flatness * (triangles[:, 2] - triangles[:, 0])
    points = rng.normal(size=(64, 3)) * rng.choice([0.3, 3.0])

    def distance(position: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points - position, axis=1)

    ours = distance(np.einsum("pk,pkc->pc", weights_on(triangles, points), triangles))
    np.testing.assert_allclose(ours, distance(trimesh.triangles.closest_point(triangles, points)), atol=1e-9)
    on_device = closest_point_on_triangle(*(jnp.asarray(x, jnp.float32) for x in (points, *triangles.swapaxes(0, 1))))
    there = distance(np.einsum("pk,pkc->pc", np.asarray(on_device, float), triangles))
    np.testing.assert_allclose(there, ours, atol=1e-4)


def test_regions_of_one_triangle() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    cases = {
        (-1.0, -1.0, 0.5): (1, 0, 0),
        (2.0, 0.0, -1.0): (0, 1, 0),
        (0.0, 3.0, 0.0): (0, 0, 1),
        (0.25, -1.0, 0.0): (0.75, 0.25, 0),
        (1.0, 1.0, 0.0): (0, 0.5, 0.5),
        (0.2, 0.3, 9.0): (0.5, 0.2, 0.3),
    }
    found = weights_on(np.tile(corners, (len(cases), 1, 1)), np.array(list(cases)))
    np.testing.assert_allclose(found, list(cases.values()), atol=1e-12)


def test_on_a_triangle_without_area_the_longest_edge_counts() -> None:
    flat = np.array([[0.0, 0, 0], [0.5, 0, 0], [1, 0, 0]])
    weights = weights_on(flat[None], np.array([[0.7, 1.0, 0]]))
    np.testing.assert_allclose(weights @ flat, [[0.7, 0, 0]], atol=1e-12)
    point = np.full((1, 3, 3), 0.25)
    np.testing.assert_allclose(weights_on(point, np.array([[1.0, 0, 0]])).sum(), 1.0)


def test_a_mesh_against_a_dense_search() -> None:
    vertices, faces = tube(8, 9)
    points = np.random.default_rng(1).uniform(-0.35, 0.35, (40, 3))
    found = MeshSearch(vertices, faces).closest(points)
    # All points of all triangles on a fine grid of barycentric weights.
    steps = np.linspace(0, 1, 41)
    grid = np.array([(1 - a - b, a, b) for a in steps for b in steps if a + b <= 1 + 1e-12])
    samples = np.einsum("gk,fkc->fgc", grid, vertices[faces]).reshape(-1, 3)
    nearest = np.sqrt(((points[:, None] - samples[None]) ** 2).sum(-1).min(axis=1))
    assert (found.distance <= nearest + 1e-9).all()
    assert (found.distance >= nearest - 0.005).all()
    assert found.weights.min() >= -1e-12
    at = np.einsum("nk,nkc->nc", found.weights, vertices[faces[found.face]])
    np.testing.assert_allclose(found.position, at, atol=1e-12)


@given(
    seed=st.integers(0, 10**6),
    spread=st.sampled_from([0.0, 1.0, 2.5]),
    limit=st.sampled_from([0.0, 0.02, 0.3, np.inf]),
    part_size=st.sampled_from([0.5, 1.0, 1.5, 10.0]),
)
def test_uneven_triangles_against_libigl(seed: int, spread: float, limit: float, part_size: float) -> None:
    """Triangles whose sizes differ up to a few hundred times; points on them, near and far."""
    rng = np.random.default_rng(seed)
    size = 0.05 * np.exp(spread * rng.normal(size=(60, 1, 1)))
    corners = rng.uniform(-1, 1, (60, 1, 3)) + size * rng.normal(size=(60, 3, 3))
    vertices, faces = corners.reshape(-1, 3), np.arange(180).reshape(-1, 3)
    on = np.einsum("pk,pkc->pc", rng.dirichlet(np.ones(3), 60), corners)
    points = np.concatenate([on, on + rng.normal(0, 0.01, on.shape), rng.uniform(-2, 2, (40, 3)), [[50.0, 0, 0]]])
    squared, _, _ = igl.point_mesh_squared_distance(points, vertices, faces)
    expected = np.sqrt(squared)
    found = MeshSearch(vertices, faces, part_size).closest(points, limit)
    near = expected < limit
    np.testing.assert_allclose(found.distance[near], expected[near], atol=1e-7)
    assert (found.distance >= expected - 1e-7).all()
    at = np.einsum("nk,nkc->nc", found.weights, vertices[faces[found.face]])
    np.testing.assert_allclose(np.linalg.norm(points - at, axis=1), found.distance, atol=1e-12)


def test_pairs_in_small_blocks_give_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = tube(8, 9)
    points = np.random.default_rng(2).uniform(-0.35, 0.35, (200, 3))
    expected = MeshSearch(vertices, faces).closest(points)
    monkeypatch.setattr(closest_points, "_PAIRS", 50)
    found = MeshSearch(vertices, faces).closest(points)
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_parts_tile_each_triangle() -> None:
    corners = np.array(
        [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [5, 0, 0], [0, 4, 0]], [[0, 0, 1], [1, 0, 1], [0, 1, 1]]]
    )
    centres, owner, reach = _parts(corners.astype(float), 1.0)
    np.testing.assert_array_equal(np.unique(owner, return_counts=True), [[0, 1, 2], [1, 25, 1]])
    # Centres of equal parts average to the centre of the whole, and no point of it is farther than `reach` from one.
    large = centres[owner == 1]
    np.testing.assert_allclose(large.mean(axis=0), [5 / 3, 4 / 3, 0], atol=1e-12)
    points = np.random.default_rng(0).dirichlet(np.ones(3), 2000) @ corners[1]
    farthest = np.linalg.norm(points[:, None] - large, axis=2).min(axis=1).max()
    assert 0.5 * reach[owner == 1].max() < farthest <= reach[owner == 1].max()
