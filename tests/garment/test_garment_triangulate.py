"""Triangulation of one panel: exact counts, quality, and the traps of Delaunay on sampled outlines."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tryon_jax.garment.curves import polygon_area, resample_polyline
from tryon_jax.garment.triangulate import (
    _scatter_inside,
    delaunay_inside,
    edge_length,
    interior_count,
    panel_fault,
    triangulate,
)
from tryon_jax.mesh.quality import measure_quality, signed_areas


def sampled(corners: list[list[float]], spacing: float) -> np.ndarray:
    """Samples on a polygon, every corner among them."""
    closed = np.array([*corners, corners[0]], float)
    sides = []
    for a, b in itertools.pairwise(closed):
        sides.append(resample_polyline(np.stack([a, b]), max(1, round(np.linalg.norm(b - a) / spacing)))[:-1])
    return np.concatenate(sides)


RECTANGLE = [[0, 0], [0.6, 0], [0.6, 0.4], [0, 0.4]]
HORSESHOE = [[0, 0], [0.6, 0], [0.6, 0.6], [0.4, 0.6], [0.4, 0.2], [0.2, 0.2], [0.2, 0.6], [0, 0.6]]


def test_edge_length_of_an_area() -> None:
    assert edge_length(np.sqrt(3) / 4) == pytest.approx(1.0)
    assert edge_length(1.78e-4) == pytest.approx(0.0203, abs=1e-4)


@pytest.mark.parametrize("corners", [RECTANGLE, HORSESHOE])
def test_collinear_samples_make_no_flat_triangles(corners: list[list[float]]) -> None:
    """Delaunay spans triangles of no area between samples of a straight edge; a test of their centroids is random."""
    outline = sampled(corners, 0.02)
    faces = delaunay_inside(outline, len(outline))
    assert len(faces) == len(outline) - 2
    area = signed_areas(outline, faces)
    assert area.min() > 1e-6
    assert area.sum() == pytest.approx(polygon_area(outline), rel=1e-12)


@pytest.mark.parametrize("corners", [RECTANGLE, HORSESHOE])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1))
def test_any_seed_gives_an_exact_mesh(corners: list[list[float]], seed: int) -> None:
    outline = sampled(corners, 0.03)
    count = interior_count(outline, 4e-4)
    points, faces = triangulate(outline, count, np.random.default_rng(seed))
    np.testing.assert_array_equal(points[: len(outline)], outline)
    assert panel_fault(points, faces, len(outline)) == ""
    quality = measure_quality(points, faces)
    assert quality.num_faces == len(outline) + 2 * count - 2
    assert quality.total_area == pytest.approx(polygon_area(outline), rel=1e-9)
    assert quality.mean_area == pytest.approx(4e-4, rel=1.5 / quality.num_faces)
    assert quality.min_angle > 20
    assert quality.max_distortion < 2.5


def test_the_start_has_exactly_as_many_points_as_asked() -> None:
    outline = sampled(HORSESHOE, 0.02)
    for count in (0, 1, 5, 200, 1000):
        points = _scatter_inside(outline, 0.02, count, np.random.default_rng(count))
        assert len(points) == count


def test_the_same_state_gives_the_same_mesh() -> None:
    outline = sampled(RECTANGLE, 0.03)
    first, second, third = (triangulate(outline, 150, np.random.default_rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])
    assert not np.array_equal(first[0], third[0])
    assert len(first[1]) == len(third[1])


def test_no_grain_is_left_of_the_starting_grid() -> None:
    """Edges of a lattice point in three directions: |mean exp(6 i angle)| is 1; of a random mesh it is near 0."""
    outline = sampled([[0, 0], [0.8, 0], [0.8, 0.8], [0, 0.8]], 0.025)
    orders = []
    for seed in range(3):
        points, faces = triangulate(outline, 1100, np.random.default_rng(seed))
        edges = points[faces[:, 1]] - points[faces[:, 0]]
        orders.append(abs(np.exp(6j * np.arctan2(edges[:, 1], edges[:, 0])).mean()))
    assert np.mean(orders) < 0.15


def test_faults_are_seen() -> None:
    outline = sampled(RECTANGLE, 0.05)
    points, faces = triangulate(outline, 60, np.random.default_rng(0))
    assert panel_fault(points, faces[1:], len(outline)).endswith("triangles in place of " + str(len(faces)))
    doubled = np.concatenate([faces[1:], faces[5:6]])
    assert "border" in panel_fault(points, doubled, len(outline))
    folded = points.copy()
    folded[-1] += [0.3, 0.3]
    assert panel_fault(folded, faces, len(outline)) == "triangles overlap"
    corner = points.copy()
    flat = faces[(faces >= len(outline)).any(axis=1)][0]
    inner = flat[flat >= len(outline)][0]
    a, b = corner[flat[flat != inner]]
    corner[inner] = (a + b) / 2 + 1e-4 * (corner[inner] - (a + b) / 2)
    assert "angle" in panel_fault(corner, faces, len(outline)) or "overlap" in panel_fault(corner, faces, len(outline))
