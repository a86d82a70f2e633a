"""Exact signed distance to a closed triangle mesh (host side, float64).

The one definition of how far a point is inside or outside a body: the distance to the closest point of the triangles,
with the sign of the angle-weighted pseudonormal of the face, edge or vertex that it lies on. That sign is right
everywhere (Bærentzen and Aanæs 2005). `contact.closest_points.signed_distances` is the same on the device.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.mesh.closest_points import MeshSearch
from tryon_jax.mesh.points_beside import PointsBeside
from tryon_jax.mesh.topology import directed_edges, edge_keys, stable_order

# Barycentric weights below this are zero: the closest point is on an edge or a vertex.
_ZERO = 1e-9
# The triangles of a body differ much in size: coarser parts are fewer to search, and as good a bound.
_PART_SIZE = 1.5


class SignedDistances(NamedTuple):
    """Where points are relative to a closed surface."""

    distance: Float[np.ndarray, " P"]
    """Metres, negative inside."""
    away: Float[np.ndarray, "P 3"]
    """Unit direction in which the distance grows."""
    position: Float[np.ndarray, "P 3"]
    """The closest point of the surface, metres."""
    face: Int[np.ndarray, " P"]
    """The triangle that it lies on."""
    weights: Float[np.ndarray, "P 3"]
    """Its barycentric weights there."""


class ClosedSurface:
    """A closed, consistently oriented mesh prepared for distance queries."""

    def __init__(self, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> None:
        """Prepare search structures and pseudonormals.

        Args:
            vertices: Metres.
            faces: Triangles, counter-clockwise seen from outside.

        Raises:
            ValueError: The mesh is not closed.
        """
        self.vertices = np.asarray(vertices, np.float64)
        self.faces = np.asarray(faces, np.int64)
        count = len(self.vertices)
        half = directed_edges(self.faces)
        keys = edge_keys(half, count)
        order = stable_order(keys)
        first = np.flatnonzero(np.diff(keys[order], prepend=-1))
        wrong = int((np.diff(first, append=len(keys)) != 2).sum())
        if wrong:
            raise ValueError(
                f"the surface must be closed: every edge needs two faces, but {wrong} edges do not have two"
            )
        other = np.empty(len(keys), np.int64)
        other[order[::2]], other[order[1::2]] = order[1::2], order[::2]
        corners = self.vertices.take(self.faces, axis=0)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
        at_vertex = np.zeros((count, 3))
        for k in range(3):
            a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
            cosine = (a * b).sum(1) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-300)
            angle = np.arccos(np.clip(cosine, -1, 1))
            for c in range(3):
                at_vertex[:, c] += np.bincount(self.faces[:, k], angle * normal[:, c], count)
        self._face_normals, self._vertex_normals = normal, at_vertex
        # Half-edge k of a face runs from corner k to corner k + 1; the other half belongs to the face across.
        across = normal.take(other % len(self.faces), axis=0).reshape(3, len(self.faces), 3)
        self._edge_normals = (normal + across).swapaxes(0, 1)
        self._search = MeshSearch(self.vertices, self.faces, _PART_SIZE)

    def closest(
        self, points: Float[np.ndarray, "P 3"], exact_below: float = np.inf, beside: PointsBeside | None = None
    ) -> SignedDistances:
        """Signed distance and closest point of each point.

        Args:
            points: Metres, finite.
            exact_below: Distances whose size is above this many metres may be too large; asking for less is faster.
            beside: As in `MeshSearch.closest`.
        """
        points = np.asarray(points, np.float64)
        found = self._search.closest(points, exact_below, beside)
        offset = points - found.position
        pseudo = self._pseudonormals(found.face, found.weights)
        sign = np.where(np.einsum("pc,pc->p", offset, pseudo) < 0, -1.0, 1.0)
        away = np.where(found.distance[:, None] > _ZERO, sign[:, None] * offset, pseudo)
        away = away / np.maximum(np.linalg.norm(away, axis=1), 1e-300)[:, None]
        return SignedDistances(sign * found.distance, away, found.position, found.face, found.weights)

    def _pseudonormals(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        result = self._face_normals[face].copy()
        zero = weights < _ZERO
        for k in range(3):
            # On the edge opposite to corner k, which is half-edge k + 1.
            on = zero[:, k] & (zero.sum(axis=1) == 1)
            result[on] = self._edge_normals[face[on], (k + 1) % 3]
            at = zero[:, (k + 1) % 3] & zero[:, (k + 2) % 3]
            result[at] = self._vertex_normals[self.faces[face[at], k]]
        return result
