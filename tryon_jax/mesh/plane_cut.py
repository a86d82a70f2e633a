"""Where a plane cuts a triangle mesh, and the length of a tape round the cut (host side)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from tryon_jax.mesh.topology import edge_keys


@dataclass(frozen=True)
class Curve:
    """A curve on a mesh: one straight segment in each face that it crosses, in no particular order."""

    faces: Int[np.ndarray, " S"]
    corners: Int[np.ndarray, "S 2"]
    """Each end lies on the edge of the face from this corner to the next."""
    fractions: Float[np.ndarray, "S 2"]
    """And this far along it, 0 to 1."""
    closed: bool
    """False where it ends at an open border."""

    def at(self, values: Float[np.ndarray, "F 3 C"]) -> Float[np.ndarray, "S 2 C"]:
        """What is given at the corners of the faces, at the ends of the segments."""
        start, end = (values[self.faces[:, None], (self.corners + step) % 3] for step in (0, 1))
        return start + self.fractions[..., None] * (end - start)

    def edges(self, faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "S 2 2"]:
        """The two vertices of the edge that each end lies on; an inner edge occurs twice."""
        return np.stack([faces[self.faces[:, None], (self.corners + step) % 3] for step in (0, 1)], axis=2)

    def length(self, values: Float[np.ndarray, "F 3 C"]) -> float:
        """Length of the curve where the corners of the faces lie at `values`, metres."""
        ends = self.at(values)
        return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1).sum())


def cut_mesh(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    point: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
) -> list[Curve]:
    """The connected curves in which the plane through `point` across `normal` cuts a mesh.

    Args:
        vertices: Metres.
        faces: Triangles of a manifold mesh, with or without borders.
        point: A point of the plane, metres.
        normal: Across the plane; need not be of unit length.
    """
    height = (vertices - point) @ normal
    above = height >= 0
    # Every face that is cut has two cut edges, side by side in this list.
    face, corner = np.nonzero(above[faces] != above[np.roll(faces, -1, axis=1)])
    start, end = faces[face, corner], faces[face, (corner + 1) % 3]
    fraction = (height[start] / (height[start] - height[end])).reshape(-1, 2)
    face, corner = face[::2], corner.reshape(-1, 2)
    keys = edge_keys(np.stack([start, end], axis=1), len(vertices))
    edges, index, uses = np.unique(keys, return_inverse=True, return_counts=True)
    segments = index.reshape(-1, 2)
    links = coo_array((np.ones(len(segments)), segments.T), shape=(len(edges), len(edges)))
    count, label = connected_components(links, directed=False)
    curves = []
    for k in range(count):
        own = label[segments[:, 0]] == k
        curves.append(Curve(face[own], corner[own], fraction[own], bool((uses[label == k] == 2).all())))
    return curves


def plane_axes(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Two unit vectors that span the plane across `normal`."""
    start = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal, start)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first) / np.linalg.norm(normal)])


def tape_length(points: Float[np.ndarray, "N 3"], normal: Float[np.ndarray, "3"]) -> float:
    """Length of a taut tape around `points`, seen along `normal`: the perimeter of their convex hull, metres."""
    return float(ConvexHull(points @ plane_axes(normal).T).area)
