"""Where points of a pattern lie on another triangulation of the same pattern."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

CANDIDATES = (3, 12)
"""Triangles with the nearest centroids that are tried before all of them are: 97 of 100 points lie in one of three."""

OUTSIDE = 1e-3
"""Barycentric weights down to minus this count as inside."""


def barycentric(
    corners: Float[np.ndarray, "... 3 2"], points: Float[np.ndarray, "... 2"]
) -> Float[np.ndarray, "... 3"]:
    """Barycentric weights of points in triangles in the plane; they sum to 1, negative outside."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]

    def cross(p: np.ndarray, q: np.ndarray) -> np.ndarray | np.float64:
        return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]

    area = cross(b - a, c - a)
    first = cross(b - points, c - points) / area
    second = cross(c - points, a - points) / area
    return np.stack([first, second, 1.0 - first - second], axis=-1)


def locate(
    points: Float[np.ndarray, "P 2"], corners: Float[np.ndarray, "N 2"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Int[np.ndarray, " P"], Float[np.ndarray, "P 3"]]:
    """The triangle each point lies in, and its weights there.

    A point outside of all triangles (the coarser mesh cuts the corners of curved outlines) gets the triangle that it
    is least outside of, and weights clamped to it: not negative, sum 1.

    Args:
        points: Points of the plane.
        corners: Corners of the triangles, in the same plane.
        faces: Triangles, indices into `corners`.

    Returns:
        Index of a triangle for each point, and three weights.
    """
    triangles = corners[faces]
    tree = cKDTree(triangles.mean(axis=1))
    face, weight = np.zeros(len(points), np.int64), np.zeros((len(points), 3))
    undecided = np.arange(len(points))
    for tried in CANDIDATES:
        near = tree.query(points[undecided], np.arange(1, min(tried, len(faces)) + 1))[1]
        weights = barycentric(triangles[near], points[undecided, None])
        inside = weights.min(axis=2)
        best = inside.argmax(axis=1)
        rows = np.arange(len(undecided))
        face[undecided], weight[undecided] = near[rows, best], weights[rows, best]
        # Strictly inside one triangle, a point is in no other.
        undecided = undecided[inside[rows, best] < 1e-9]
    lost = np.flatnonzero(weight.min(axis=1) < -OUTSIDE)
    for part in np.array_split(lost, max(1, len(lost) * len(faces) // 2_000_000)):
        every = barycentric(triangles[None], points[part][:, None])
        face[part] = every.min(axis=2).argmax(axis=1)
        weight[part] = every[np.arange(len(part)), face[part]]
    weight = np.maximum(weight, 0.0)
    return face, weight / weight.sum(axis=1, keepdims=True)


def on_edges(
    fine: Mapping[str, Int[np.ndarray, " _"]], coarse: Mapping[str, Int[np.ndarray, " _"]]
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, "P 3"], Float[np.ndarray, "P 3"]]:
    """Weights of outline samples on a coarser sampling of the same edges, by their fraction of each edge.

    Both samplings are uniform along every edge, so the fraction alone says where a sample lies: the two sides of a
    seam get the same place on the template, which a search in UV would not promise.

    Returns:
        the fine samples, the coarse samples at both ends of the interval (the last column repeats the first with
        weight 0), and the weights.
    """
    samples, ends, weights = [], [], []
    for edge, index in fine.items():
        knots = coarse[edge]
        at = np.linspace(0.0, len(knots) - 1.0, len(index))
        low = np.minimum(at.astype(int), len(knots) - 2)
        part = at - low
        samples.append(index)
        ends.append(np.stack([knots[low], knots[low + 1], knots[low]], axis=1))
        weights.append(np.stack([1.0 - part, part, np.zeros_like(part)], axis=1))
    order, first = np.unique(np.concatenate(samples), return_index=True)
    return order, np.concatenate(ends)[first], np.concatenate(weights)[first]


def tie_panel(
    points: Float[np.ndarray, "N 2"],
    edges: Mapping[str, Int[np.ndarray, " _"]],
    base_points: Float[np.ndarray, "M 2"],
    base_faces: Int[np.ndarray, "F 3"],
    base_edges: Mapping[str, Int[np.ndarray, " _"]],
) -> tuple[Int[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Barycentric map from one triangulation of a panel (`base`) to another: three points and weights for each point.

    Samples on the outline go by their fraction of the edge, points inside by the triangle that they lie in.

    Args:
        points: Of the one triangulation, metres.
        edges: Its outline samples by edge, from end to end.
        base_points: Of the base, metres.
        base_faces: Triangles of the base.
        base_edges: Outline samples of the base by edge.

    Returns:
        Three indices into `base_points` for each point, and their weights.
    """
    corners = np.zeros((len(points), 3), np.int64)
    weights = np.zeros((len(points), 3))
    samples, corners_there, weights_there = on_edges(edges, base_edges)
    inner = np.setdiff1d(np.arange(len(points)), samples, assume_unique=True)
    face, weights[inner] = locate(points[inner], base_points, base_faces)
    corners[inner] = base_faces[face]
    corners[samples], weights[samples] = corners_there, weights_there
    return corners, weights
