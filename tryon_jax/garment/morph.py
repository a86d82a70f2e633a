"""Moving a triangulated panel from one outline to another without inverting a triangle.

One harmonic or mean-value map from the reference to a far design folds triangles at the underarm, where the outline
is concave. Several short steps, each with the mean-value weights (Floater, "Mean value coordinates", CAGD 2003) of
the shape reached so far, followed by an untangling of the few triangles that still come out thin, do not.
"""

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.linalg import splu

from tryon_jax.mesh.quality import signed_areas

STEPS = 6
"""Steps of the morph between two designs."""

SPREAD_STEPS = 25
"""Steps of the smoothing that follows."""


def mean_value_laplacian(points: Float[np.ndarray, "N 2"], faces: Int[np.ndarray, "F 3"]) -> sp.csr_matrix:
    """Laplacian whose rows reproduce each inner point as an average of its neighbours with positive weights."""
    count = len(points)
    rows, cols, weights = [], [], []
    for k in range(3):
        a, b, c = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        at = points.take(a, axis=0)
        u, v = points.take(b, axis=0) - at, points.take(c, axis=0) - at
        cross = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        half_tangent = np.tan(np.arctan2(cross, (u * v).sum(1)) / 2)
        rows += [a, a]
        cols += [b, c]
        weights += [half_tangent / np.linalg.norm(u, axis=1), half_tangent / np.linalg.norm(v, axis=1)]
    matrix = sp.coo_matrix((np.concatenate(weights), (np.concatenate(rows), np.concatenate(cols))), (count, count))
    matrix = matrix.tocsr()
    return (sp.diags(np.asarray(matrix.sum(axis=1)).ravel()) - matrix).tocsr()


def morph(
    points: Float[np.ndarray, "N 2"],
    faces: Int[np.ndarray, "F 3"],
    outline_at: Callable[[float], Float[np.ndarray, "B 2"]],
    steps: int = STEPS,
) -> Float[np.ndarray, "N 2"]:
    """Carry a panel along a path of outlines.

    Args:
        points: the panel at the start of the path, outline first.
        faces: its triangles, counter-clockwise.
        outline_at: outline samples at t in (0, 1]; at 0 it would be the panel's own.
        steps: number of steps along the path.

    Returns:
        the panel's points at the end of the path.
    """
    for t in np.linspace(0.0, 1.0, steps + 1)[1:]:
        outline = outline_at(float(t))
        fixed = len(outline)
        laplacian = mean_value_laplacian(points, faces)
        shift = np.zeros_like(points)
        shift[:fixed] = outline - points[:fixed]
        inner = splu(laplacian[fixed:, fixed:].tocsc())
        shift[fixed:] = inner.solve(-(laplacian[fixed:, :fixed] @ shift[:fixed]))
        points = points + shift
    return spread(untangle(points, faces, fixed), faces, fixed)


def untangle(
    points: Float[np.ndarray, "N 2"],
    faces: Int[np.ndarray, "F 3"],
    num_outline: int,
    iterations: int = 60,
) -> Float[np.ndarray, "N 2"]:
    """Move inner corners of triangles with less than 0.15 of the median area until they have it.

    Args:
        points: Of a panel, metres; those of the outline first.
        faces: Triangles.
        num_outline: How many points are the outline's, which stay.
        iterations: Steps at most.

    Returns:
        The points, moved.
    """
    points = points.copy()
    enough = 0.15 * np.median(signed_areas(points, faces))
    for _ in range(iterations):
        area = signed_areas(points, faces)
        bad = area < enough
        if not bad.any():
            break
        corners = faces[bad]
        lack = enough - area[bad]
        gradient = _area_gradients(points[corners])
        scale = lack[:, None] / np.maximum((gradient**2).sum(axis=2), 1e-12) / 2
        move = _gather(corners, scale[:, :, None] * gradient, len(points))
        move[:num_outline] = 0.0
        points += 0.5 * move
    return points


def spread(
    points: Float[np.ndarray, "N 2"],
    faces: Int[np.ndarray, "F 3"],
    num_outline: int,
    iterations: int = SPREAD_STEPS,
) -> Float[np.ndarray, "N 2"]:
    """Move inner points to make triangles rounder: Jacobi steps on the sum of squared mean-ratio qualities.

    The quality (l₁² + l₂² + l₃²) / (4 √3 area) is 1 for an equilateral triangle and infinite for a flat one, so no
    triangle is inverted on the way. Points without inverted triangles are needed; others are returned as they came.

    Args:
        points: Of a panel, metres; those of the outline first.
        faces: Triangles.
        num_outline: How many points are the outline's, which stay.
        iterations: Steps at most.

    Returns:
        The points, moved.
    """
    if signed_areas(points, faces).min() <= 0:
        return points
    inner = np.arange(len(points)) >= num_outline
    energy, gradient, curvature = _mean_ratio(points, faces)
    for _ in range(iterations):
        move = np.where(inner[:, None], -gradient / curvature[:, None], 0.0)
        for _ in range(8):
            trial = points + move
            if signed_areas(trial, faces).min() > 0:
                new = _mean_ratio(trial, faces)
                if new[0] < energy:
                    points, (energy, gradient, curvature) = trial, new
                    break
            move /= 2
        else:
            break
    return points


def _mean_ratio(points: np.ndarray, faces: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Energy, its gradient, and a positive diagonal that bounds its curvature."""
    corners = points.take(faces, axis=0)
    area = signed_areas(points, faces)[:, None]
    following, preceding = np.roll(corners, -1, axis=1), np.roll(corners, 1, axis=1)
    ratio = ((following - corners) ** 2).sum(axis=(1, 2))[:, None] / (4 * np.sqrt(3) * area)
    by_area = _area_gradients(corners)
    by_length = 2 * (2 * corners - following - preceding) / (4 * np.sqrt(3) * area)[:, :, None]
    gradient = 2 * ratio[:, :, None] * (by_length - (ratio / area)[:, :, None] * by_area)
    curvature = 2 * ratio * (1 / (np.sqrt(3) * area) + 2 * ratio / area**2 * (by_area**2).sum(axis=2))
    bound = np.bincount(faces.ravel(), curvature.ravel(), len(points))
    return float((ratio**2).sum()), _gather(faces, gradient, len(points)), bound


def _area_gradients(corners: np.ndarray) -> np.ndarray:
    """Derivative of each triangle's area by its corners [F, 3, 2]."""
    away = np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1)
    return 0.5 * np.stack([away[:, :, 1], -away[:, :, 0]], axis=2)


def _gather(faces: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sum over the corners at each point."""
    at = faces.ravel()
    return np.stack([np.bincount(at, values[:, :, k].ravel(), count) for k in range(2)], axis=1)
