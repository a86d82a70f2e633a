"""Carrying a triangulated panel from one outline to another without turning a triangle over.

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


def mean_value_laplacian(points: Float[np.ndarray, "N 2"], faces: Int[np.ndarray, "F 3"]) -> sp.csr_matrix:
    """Laplacian whose rows reproduce each inner point as an average of its neighbours with positive weights."""
    count = len(points)
    rows, cols, weights = [], [], []
    for k in range(3):
        a, b, c = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        u, v = points[b] - points[a], points[c] - points[a]
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
    return untangle(points, faces, fixed)


def untangle(
    points: Float[np.ndarray, "N 2"],
    faces: Int[np.ndarray, "F 3"],
    num_outline: int,
    iterations: int = 60,
) -> Float[np.ndarray, "N 2"]:
    """Move inner corners of triangles with less than 0.15 of the median area until they have it."""
    points = points.copy()
    enough = 0.15 * np.median(signed_areas(points, faces))
    for _ in range(iterations):
        area = signed_areas(points, faces)
        bad = area < enough
        if not bad.any():
            break
        corners = faces[bad]
        lack = enough - area[bad]
        move = np.zeros_like(points)
        for k in range(3):
            b, c = points[corners[:, (k + 1) % 3]], points[corners[:, (k + 2) % 3]]
            gradient = 0.5 * np.stack([b[:, 1] - c[:, 1], c[:, 0] - b[:, 0]], axis=1)
            scale = lack / np.maximum((gradient**2).sum(axis=1), 1e-12) / 2
            np.add.at(move, corners[:, k], scale[:, None] * gradient)
        move[:num_outline] = 0.0
        points += 0.5 * move
    return points
