"""Plane curves: analytic lengths, areas and crossings."""

import numpy as np
import pytest

from tryon_jax.garment import curves


def circle(count: int, radius: float = 1.0) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_quarter_circle_by_cubic() -> None:
    """The usual Bézier quarter circle is off by 0.03 % of its radius."""
    k = 4 / 3 * (np.sqrt(2) - 1)
    line = curves.sample_segment("cubic", np.array([[1, 0], [1, k], [k, 1], [0, 1.0]]))
    np.testing.assert_allclose(np.linalg.norm(line, axis=1), 1.0, atol=3e-4)
    assert curves.length(line) == pytest.approx(np.pi / 2, rel=5e-4)


def test_quadratic_is_a_parabola() -> None:
    line = curves.sample_segment("quadratic", np.array([[0, 0], [1, 0], [2, 2.0]]))
    np.testing.assert_allclose(line[:, 1], line[:, 0] ** 2 / 2, atol=1e-12)


def test_line_keeps_its_ends() -> None:
    ends = np.array([[0, 0], [3, 4.0]])
    np.testing.assert_array_equal(curves.sample_segment("line", ends), ends)
    assert curves.length(ends) == 5.0


def test_resample_is_uniform_and_keeps_the_ends() -> None:
    line = np.array([[0, 0], [1, 0], [1, 2], [1, 2.5]])
    points = curves.resample_polyline(line, 7)
    np.testing.assert_allclose(curves.arc_length(points), np.linspace(0, 3.5, 8), atol=1e-12)
    np.testing.assert_array_equal(points[[0, -1]], line[[0, -1]])


def test_join_drops_repeated_points() -> None:
    a = np.array([[0, 0], [1, 0.0]])
    joined = curves.join_polylines([a, np.array([[1, 0], [1, 0], [1, 1.0]])])
    np.testing.assert_array_equal(joined, [[0, 0], [1, 0], [1, 1]])


def test_area_is_signed() -> None:
    assert curves.polygon_area(circle(4000)) == pytest.approx(np.pi, rel=1e-5)
    assert curves.polygon_area(circle(4000)[::-1]) == pytest.approx(-np.pi, rel=1e-5)


def test_inside_a_circle() -> None:
    points = np.random.default_rng(0).uniform(-1.2, 1.2, (2000, 2))
    radius = np.linalg.norm(points, axis=1)
    clear = abs(radius - 1) > 1e-3
    np.testing.assert_array_equal(curves.inside_polygon(circle(500), points)[clear], (radius < 1)[clear])


def test_inside_a_concave_outline() -> None:
    horseshoe = np.array([[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3.0]])
    points = np.array([[0.5, 2.5], [1.5, 2.0], [2.5, 2.5], [1.5, 0.5], [1.5, 3.5], [-1, 1]])
    np.testing.assert_array_equal(curves.inside_polygon(horseshoe, points), [True, False, True, True, False, False])


def test_crossings_are_found() -> None:
    eight = np.array([[0, 0], [1, 1], [1, 0], [0, 1.0]])
    crossing = curves.first_crossing(eight)
    assert crossing is not None
    assert sorted(crossing) == [0, 2]
    assert curves.first_crossing(circle(100)) is None
