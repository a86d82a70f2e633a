"""Distances between surfaces whose answers are known."""

import numpy as np
import pytest
import trimesh

from tryon_jax.metrics import (
    angle_between_normals,
    directed_distances,
    hausdorff_distance,
    sample_surface,
    vertex_distances,
)


def plate(cells: int, lift: float = 0.0, size: float = 0.1):
    """A flat square in the plane y = lift."""
    x, z = np.meshgrid(np.linspace(0, size, cells + 1), np.linspace(0, size, cells + 1), indexing="ij")
    points = np.stack([x, np.full_like(x, lift), z], axis=-1).reshape(-1, 3)
    index = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel()
    return points, np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])


def test_vertex_distances_of_a_translation():
    points, _ = plate(3)
    np.testing.assert_allclose(vertex_distances(points, points + np.array([[0.0, 0.003, 0.004]])), 0.005)


def test_hausdorff_does_not_see_the_triangulation():
    one, other = plate(3), plate(7)
    assert hausdorff_distance(*one, *other) < 1e-6
    lifted = plate(7, lift=0.012)
    assert hausdorff_distance(*one, *lifted) == pytest.approx(0.012, abs=1e-6)


def test_hausdorff_is_symmetric_and_sees_what_lies_between_vertices():
    points, faces = plate(1)
    # A small plate is close to the large one everywhere, but not the other way round.
    small = plate(1, size=0.05)
    expected = np.hypot(0.05, 0.05)
    assert hausdorff_distance(points, faces, *small) == pytest.approx(expected, abs=1e-6)
    assert hausdorff_distance(*small, points, faces) == pytest.approx(expected, abs=1e-6)
    assert directed_distances(sample_surface(*small).points, points, faces).max() < 1e-6
    # One triangle inside which another's only near vertex lies: vertices alone would be 3 cm off.
    far = np.array([[0.05, 0.01, 0.05]])
    assert directed_distances(far, points, faces)[0] == pytest.approx(0.01, abs=1e-6)


def test_hausdorff_of_concentric_spheres():
    small = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    large = trimesh.creation.icosphere(subdivisions=4, radius=0.13)
    found = hausdorff_distance(small.vertices, small.faces, large.vertices, large.faces, spacing=0.01)
    assert found == pytest.approx(0.03, abs=0.001)


def test_the_block_search_agrees_with_every_sample():
    rng = np.random.default_rng(0)
    one, other = plate(6), plate(5)
    shaken = one[0] + rng.normal(0, 0.004, one[0].shape)
    all_samples = max(
        directed_distances(sample_surface(shaken, one[1]).points, *other).max(),
        directed_distances(sample_surface(*other).points, shaken, one[1]).max(),
    )
    assert hausdorff_distance(shaken, one[1], *other) == pytest.approx(all_samples, abs=1e-9)


def test_samples_are_dense_and_lie_on_their_faces():
    points, faces = plate(2)
    samples = sample_surface(points, faces, spacing=0.01)
    assert len(samples.points) == len(faces) * 9 * 10 // 2
    centre = points[faces].mean(axis=1)[samples.faces]
    assert np.linalg.norm(samples.points - centre, axis=1).max() <= 0.05
    assert np.abs(samples.points[:, 1]).max() == 0


def test_bad_input():
    points, faces = plate(1)
    with pytest.raises(ValueError, match="sample spacing"):
        sample_surface(points, faces, spacing=0.0)
    with pytest.raises(ValueError, match="longest edge"):
        sample_surface(points, faces, spacing=1e-4)
    points[0] = np.nan
    with pytest.raises(ValueError, match="vertices must be finite"):
        sample_surface(points, faces)


def test_normals_turn_with_the_surface():
    points, faces = plate(3)
    angle = 0.3
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    np.testing.assert_allclose(angle_between_normals(points, points @ turn.T, faces), angle, atol=1e-5)
    np.testing.assert_allclose(angle_between_normals(points, points, faces), 0.0, atol=1e-6)
