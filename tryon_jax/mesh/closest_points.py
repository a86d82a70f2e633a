"""Closest points on any triangle mesh, exact (host side, float64).

Triangles are cut into similar parts of about one size. The closest triangle is found among those of the parts with the
closest centres. A bound says for which points a part with a farther centre could still be closer; for those the search
is widened until none can.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tryon_jax.mesh.triangles import Triangles

_FIRST, _CHUNK = 8, 100_000
# Parts along an edge into which a triangle is cut at most.
_MOST_CUTS = 16


class ClosestPoints(NamedTuple):
    """The point of a mesh closest to each of P points."""

    distance: Float[np.ndarray, " P"]
    """Metres, not signed."""
    face: Int[np.ndarray, " P"]
    """The triangle that it lies on."""
    weights: Float[np.ndarray, "P 3"]
    """Its barycentric weights there."""
    position: Float[np.ndarray, "P 3"]
    """Metres."""


class MeshSearch:
    """A triangle mesh prepared for closest-point queries."""

    def __init__(self, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> None:
        """Prepare a mesh of at least one triangle; open, closed, of even or uneven triangles."""
        self._corners = np.asarray(vertices, np.float64)[np.asarray(faces)]
        self._triangles = Triangles(self._corners)
        centres, self._part_of, self._reach = _parts(self._corners)
        self._most = self._reach.max()
        self._centres = cKDTree(centres)

    def closest(self, points: Float[np.ndarray, "P 3"], exact_below: float = np.inf) -> ClosestPoints:
        """The closest point of the mesh to each point.

        Args:
            points: Metres, finite.
            exact_below: Distances above this many metres may be too large; asking for less is faster. With 0 all are
            upper bounds.
        """
        points = np.asarray(points, np.float64)
        distance = np.full(len(points), np.inf)
        face = np.zeros(len(points), np.int64)
        weights = np.zeros((len(points), 3))
        # Where even the closest centre is farther than that, a rough answer will do.
        first, part = self._centres.query(points, k=1)
        self._try(points, np.arange(len(points)), first[:, None], part[:, None], distance, face, weights)
        open_rows = np.flatnonzero((first - self._most < exact_below) & (exact_below > 0))
        count = min(_FIRST, len(self._part_of))
        while len(open_rows):
            # Where the closest centre is farther than bound + reach, so is every triangle.
            limit = np.full(len(open_rows), np.inf)
            for start in range(0, len(open_rows), max(_CHUNK // count, 1)):
                chunk = slice(start, start + max(_CHUNK // count, 1))
                rows = open_rows[chunk]
                far, candidates = self._centres.query(points[rows], k=count)
                far, candidates = far.reshape(len(rows), -1), candidates.reshape(len(rows), -1)
                self._try(points, rows, far, candidates, distance, face, weights)
                limit[chunk] = far[:, -1] - self._most
            if count == len(self._part_of):
                break
            open_rows = open_rows[(distance[open_rows] > limit) & (limit < exact_below)]
            count = min(4 * count, len(self._part_of))
        position = np.einsum("pk,pkc->pc", weights, self._corners[face])
        return ClosestPoints(np.linalg.norm(points - position, axis=1), face, weights, position)

    def _try(
        self,
        points: np.ndarray,
        rows: np.ndarray,
        far: np.ndarray,
        candidates: np.ndarray,
        distance: np.ndarray,
        face: np.ndarray,
        weights: np.ndarray,
    ) -> None:
        """Take the closest triangle of the candidate parts of each row where it is closer than what is known."""
        # No point of a part is closer than its centre less its reach: most candidates are ruled out by that.
        row, column = np.nonzero(far - self._reach[candidates] < distance[rows, None])
        faces = self._part_of[candidates[row, column]]
        squared, v, w = (a[:, 0] for a in self._triangles.closest(points[rows[row]], faces[:, None]))
        found = np.sqrt(squared)
        # The first of the closest in each row.
        order = np.lexsort((found, row))
        taken = order[np.r_[True, row[1:] != row[:-1]]] if len(row) else order
        taken = taken[found[taken] < distance[rows[row[taken]]]]
        at = rows[row[taken]]
        distance[at], face[at] = found[taken], faces[taken]
        weights[at] = np.stack([1 - v[taken] - w[taken], v[taken], w[taken]], axis=1)


def _parts(
    corners: Float[np.ndarray, "F 3 3"],
) -> tuple[Float[np.ndarray, "S 3"], Int[np.ndarray, " S"], Float[np.ndarray, " S"]]:
    """Triangles cut into n² similar parts each, none much larger than the median triangle.

    Returns:
        Centres of the parts, the triangle of each, and the farthest that a point of each is from its centre, metres.
    """
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    cuts = np.clip(np.ceil(radius / max(float(np.median(radius)), 1e-300)), 1, _MOST_CUTS).astype(np.int64)
    centres, owner = [], []
    for n in np.unique(cuts):
        rows = np.flatnonzero(cuts == n)
        i, j = np.divmod(np.arange(n * n), n)
        # Row i of the triangle has 2 (n - i) - 1 parts, upright and upside down in turn; here they fill a square.
        upright = i + j < n
        v = np.where(upright, i + 1 / 3, n - i - 1 / 3) / n
        w = np.where(upright, j + 1 / 3, n - j - 1 / 3) / n
        centres.append(np.einsum("sk,fkc->fsc", np.stack([1 - v - w, v, w], axis=1), corners[rows]).reshape(-1, 3))
        owner.append(np.repeat(rows, n * n))
    owners = np.concatenate(owner)
    return np.concatenate(centres), owners, (radius / cuts)[owners]
