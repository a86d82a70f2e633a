"""Exact signed distance: against shapes with a formula, against brute force, signs at edges and corners."""

import numpy as np
import pytest
import trimesh

from tryon_jax.mesh.signed_distance import ClosedSurface, _closest_on_triangles


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
    corners = np.broadcast_to(vertices[mesh.faces], (200, len(mesh.faces), 3, 3))
    weights = _closest_on_triangles(points[:, None, :], corners)
    offset = np.einsum("nkc,nkci->nki", weights, corners) - points[:, None]
    np.testing.assert_allclose(np.abs(distance), np.linalg.norm(offset, axis=2).min(axis=1), atol=1e-12)
    near, _, _ = surface.closest(points, exact_below=0.05)
    close = np.abs(distance) < 0.05
    np.testing.assert_allclose(near[close], distance[close], atol=1e-12)


def test_direction_on_the_surface_itself_is_outward():
    box = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    distance, _, away = ClosedSurface(box.vertices, box.faces).closest(np.array([[0.5, 0.1, 0.2], [0.5, 0.5, 0.0]]))
    np.testing.assert_allclose(distance, 0.0, atol=1e-12)
    np.testing.assert_allclose(away, [[1, 0, 0], [0.5**0.5, 0.5**0.5, 0]], atol=1e-9)


def test_open_mesh_is_refused():
    box = trimesh.creation.box()
    with pytest.raises(ValueError, match="3 edges have not two faces"):
        ClosedSurface(box.vertices, box.faces[1:])
