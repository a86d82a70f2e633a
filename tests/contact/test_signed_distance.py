"""Exact signed distance: against shapes with a formula, against brute force, signs at edges and corners."""

import numpy as np
import pytest
import trimesh

from tryon_jax.contact.signed_distance import ClosedSurface, _parts


def test_box_has_its_analytic_distance_inside_outside_and_at_corners():
    box = trimesh.creation.box(extents=(2.0, 1.0, 0.6))
    surface = ClosedSurface(box.vertices, box.faces)
    points = np.random.default_rng(0).uniform(-2, 2, (400, 3))
    q = np.abs(points) - np.array([1.0, 0.5, 0.3])
    expected = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    distance, closest, away = surface.closest(points)
    np.testing.assert_allclose(distance, expected, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(points - closest, axis=1), np.abs(expected), atol=1e-9)
    # Going along `away` increases the distance at unit rate.
    ahead, _, _ = surface.closest(points + 1e-6 * away)
    np.testing.assert_allclose(ahead - distance, 1e-6, atol=1e-9)


def test_equals_brute_force_on_an_uneven_mesh():
    mesh = trimesh.creation.icosphere(subdivisions=2)
    vertices = mesh.vertices * [1.0, 0.3, 0.1] + 0.05 * np.sin(9 * mesh.vertices[:, [1, 2, 0]])
    surface = ClosedSurface(vertices, mesh.faces)
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (200, 3)) * [1, 0.6, 0.4]
    distance, _, _ = surface.closest(points)
    corners, count = vertices[mesh.faces], len(mesh.faces)
    # Every pair, by another implementation.
    found = trimesh.triangles.closest_point(np.tile(corners, (200, 1, 1)), np.repeat(points, count, axis=0))
    offset = np.linalg.norm(found.reshape(200, count, 3) - points[:, None], axis=2)
    np.testing.assert_allclose(np.abs(distance), offset.min(axis=1), atol=1e-12)
    near, _, _ = surface.closest(points, exact_below=0.05)
    close = np.abs(distance) < 0.05
    np.testing.assert_allclose(near[close], distance[close], atol=1e-12)


def test_parts_tile_each_triangle():
    corners = np.array(
        [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [5, 0, 0], [0, 4, 0]], [[0, 0, 1], [1, 0, 1], [0, 1, 1]]]
    )
    centres, owner, reach = _parts(corners.astype(float))
    np.testing.assert_array_equal(np.unique(owner, return_counts=True), [[0, 1, 2], [1, 25, 1]])
    # Centres of equal parts average to the centre of the whole, and no point of it is farther than `reach` from one.
    large = centres[owner == 1]
    np.testing.assert_allclose(large.mean(axis=0), [5 / 3, 4 / 3, 0], atol=1e-12)
    points = np.random.default_rng(0).dirichlet(np.ones(3), 2000) @ corners[1]
    farthest = np.linalg.norm(points[:, None] - large, axis=2).min(axis=1).max()
    assert 0.5 * reach < farthest <= reach


def test_direction_on_the_surface_itself_is_outward():
    box = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    distance, _, away = ClosedSurface(box.vertices, box.faces).closest(np.array([[0.5, 0.1, 0.2], [0.5, 0.5, 0.0]]))
    np.testing.assert_allclose(distance, 0.0, atol=1e-12)
    np.testing.assert_allclose(away, [[1, 0, 0], [0.5**0.5, 0.5**0.5, 0]], atol=1e-9)


def test_open_mesh_is_refused():
    box = trimesh.creation.box()
    with pytest.raises(ValueError, match="3 edges have not two faces"):
        ClosedSurface(box.vertices, box.faces[1:])
