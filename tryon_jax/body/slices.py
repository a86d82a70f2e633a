"""Plane slices of a closed mesh and their convex girth (host side): how a tape measure sees a body."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull


@dataclass(frozen=True)
class Outline:
    """One closed curve of a plane slice, as points on mesh edges (in no particular order)."""

    edges: Int[np.ndarray, "N 2"]
    """Vertices at the ends of the cut edges."""
    fraction: Float[np.ndarray, " N"]
    """Where the plane cuts each edge: 0 at its first end, 1 at its second."""
    points: Float[np.ndarray, "N 3"]
    """The cut points, metres."""


def plane_axes(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Two unit vectors that span the plane across `normal`."""
    start = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal, start)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first) / np.linalg.norm(normal)])


def slice_mesh(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    point: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
) -> list[Outline]:
    """The closed curves in which the plane through `point` across `normal` cuts a closed mesh."""
    height = (vertices - point) @ normal
    above = height >= 0
    cut = above[faces] != above[np.roll(faces, -1, axis=1)]
    face, corner = np.nonzero(cut)  # two cut edges in each face that the plane meets, side by side
    ends = np.sort(np.stack([faces[face, corner], faces[face, (corner + 1) % 3]], axis=1), axis=1)
    edges, index = np.unique(ends, axis=0, return_inverse=True)
    pairs = index.reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(edges), len(edges)))
    count, label = connected_components(graph, directed=False)
    low, high = height[edges[:, 0]], height[edges[:, 1]]
    fraction = low / np.where(low == high, 1.0, low - high)
    points = vertices[edges[:, 0]] * (1 - fraction)[:, None] + vertices[edges[:, 1]] * fraction[:, None]
    return [Outline(edges[label == k], fraction[label == k], points[label == k]) for k in range(count)]


def girth_of(points: Float[np.ndarray, "N 3"], normal: Float[np.ndarray, "3"]) -> float:
    """Length of a tape around `points`, seen along `normal`: the perimeter of their convex hull, metres."""
    flat = points @ plane_axes(normal).T
    return float(ConvexHull(flat).area)


def outline_around(
    outlines: list[Outline], inside: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]
) -> Outline | None:
    """The largest of the curves whose bounding box in the plane holds `inside`, or None."""
    axes = plane_axes(normal)
    centre = axes @ inside
    around = [
        outline
        for outline in outlines
        if len(outline.points) > 3
        and ((outline.points @ axes.T).min(axis=0) < centre).all()
        and ((outline.points @ axes.T).max(axis=0) > centre).all()
    ]
    return max(around, key=lambda outline: girth_of(outline.points, normal), default=None)
