"""Areas, angles and distortion against triangles that one can work out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tryon_jax.mesh.quality import angles, areas, distortion, edge_lengths, measure_quality, signed_areas

ONE = np.array([[0, 1, 2]])
EQUILATERAL = np.array([[0, 0], [1, 0], [0.5, np.sqrt(3) / 2]])
RIGHT = np.array([[0, 0], [3, 0], [0, 4.0]])


def isosceles(apex: float) -> np.ndarray:
    """Two edges of length 1 with `apex` degrees between them."""
    turn = np.radians(apex)
    return np.array([[0, 0], [1, 0], [np.cos(turn), np.sin(turn)]])


def test_right_triangle() -> None:
    assert signed_areas(RIGHT, ONE)[0] == 6
    assert signed_areas(RIGHT, ONE[:, ::-1])[0] == -6
    assert areas(RIGHT, ONE)[0] == pytest.approx(6)
    np.testing.assert_allclose(edge_lengths(RIGHT, ONE), [[3, 5, 4]])
    np.testing.assert_allclose(np.degrees(angles(RIGHT, ONE)), [[90, 53.130102, 36.869898]])


def test_distortion_is_what_its_docstring_says() -> None:
    assert distortion(EQUILATERAL, ONE)[0] == pytest.approx(1.0)
    assert distortion(isosceles(20), ONE)[0] == pytest.approx(2.0, abs=0.02)
    assert distortion(RIGHT, ONE)[0] == pytest.approx(5 / (2 * np.sqrt(3) * 1.0))
    assert distortion(isosceles(0.1), ONE)[0] > 100
    assert distortion(isosceles(179.9), ONE)[0] > 100
    assert np.isfinite(distortion(np.zeros((3, 2)), ONE)[0])


@given(st.floats(0, 6.2), st.floats(0.01, 100), st.floats(-5, 5))
def test_space_and_scale_do_not_matter(turn: float, scale: float, shift: float) -> None:
    c, s = np.cos(turn), np.sin(turn)
    flat = np.concatenate([RIGHT, np.zeros((3, 1))], axis=1)
    turned = scale * flat @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) + shift
    np.testing.assert_allclose(areas(turned, ONE), 6 * scale**2, rtol=1e-6)
    np.testing.assert_allclose(angles(turned, ONE), angles(RIGHT, ONE), atol=1e-5)
    np.testing.assert_allclose(distortion(turned, ONE), distortion(RIGHT, ONE), rtol=1e-5)


def test_summary() -> None:
    square = np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]])
    quality = measure_quality(square, np.array([[0, 1, 2], [0, 2, 3]]))
    assert quality.num_faces == 2
    assert quality.total_area == pytest.approx(4)
    assert quality.mean_area == pytest.approx(2)
    assert quality.area_variation == pytest.approx(0)
    assert quality.min_angle == pytest.approx(45)
    assert quality.median_angle == pytest.approx(45)
    assert quality.max_distortion == pytest.approx((1 + np.sqrt(2)) / np.sqrt(3))
    assert quality.mean_distortion == pytest.approx(quality.max_distortion)
