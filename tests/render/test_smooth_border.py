"""Borders become curves, and nothing else moves."""

import numpy as np
import pytest

from tryon_jax.render.smooth_border import smooth_border


def disc(corners: int = 12) -> tuple[np.ndarray, np.ndarray]:
    angle = np.arange(corners) * 2 * np.pi / corners
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    faces = [[0, 1 + k, 1 + (k + 1) % corners] for k in range(corners)]
    return np.concatenate([[[0.0, 0.0, 0.5]], rim]), np.array(faces)


def test_a_rim_becomes_rounder_and_the_middle_stays() -> None:
    vertices, faces = disc()
    fine, cut, values = smooth_border(vertices, faces, vertices)
    # Values know nothing of the curve: they are those of the triangles.
    assert np.linalg.norm(values - fine, axis=1).max() == pytest.approx(0.25 * (1 - np.cos(np.pi / 6)))
    assert len(cut) == 4 * len(faces)
    np.testing.assert_array_equal(fine[0], vertices[0])
    # Neighbouring vertices of the finer rim turn by half the angle at most.
    radius = np.linalg.norm(fine[:, :2], axis=1)
    rim = fine[(radius > 0.9) & (np.abs(fine[:, 2]) < 1e-9)]
    assert len(rim) == 24
    before = np.linalg.norm(vertices[1:, :2], axis=1).mean() - np.cos(np.pi / 12)
    assert np.ptp(np.linalg.norm(rim[:, :2], axis=1)) < 0.6 * before


def test_a_closed_mesh_is_only_cut() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    fine, cut, _ = smooth_border(vertices, faces, vertices)
    np.testing.assert_array_equal(fine[:4], vertices)
    assert len(cut) == 16


def test_colours_are_mixed_along_the_edges() -> None:
    vertices, faces = disc(6)
    colors = np.arange(21.0).reshape(7, 3) / 21
    fine, _, mixed = smooth_border(vertices, faces, colors)
    assert len(mixed) == len(fine)
    np.testing.assert_allclose(mixed[:7], colors)
    assert mixed.min() >= colors.min()
    assert mixed.max() == pytest.approx(colors.max())
