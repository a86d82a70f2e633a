"""Closest points on any triangle mesh, exact (host side, float64).

Triangles are cut into similar parts of about one size. No point of a part is farther from its centre than the part's
reach. So every part that may hold the closest point has its centre within an upper bound of the distance and the
largest reach; a search in both trees at once, of points and of centres, finds all such pairs.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tryon_jax.mesh.discs import Discs
from tryon_jax.mesh.points_beside import PointsBeside
from tryon_jax.mesh.triangles import Triangles

# Pairs of a point and a part that are held at a time, about: their arrays stay in the processor's cache.
_PAIRS = 25_000
# Points whose neighbours are counted to guess how many pairs there will be.
_PROBES = 64
# Points are searched together when their radii differ by less than this factor.
_SIMILAR = 1.25
# Distances up to this many times the largest reach are searched with one radius for all points.
_AT_ONCE = 2.0
# Points within this part of the largest reach are looked for before others.
_ON_IT = 0.2
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

    def __init__(
        self, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], part_size: float = 1.0
    ) -> None:
        """Prepare a mesh of at least one triangle; open, closed, of even or uneven triangles.

        Args:
            vertices: Metres.
            faces: Triangles.
            part_size: Triangles are cut until none is larger than this many times the median one. Results are the same
            for any, except which of several triangles is taken that are equally close up to rounding.
        """
        self._corners = np.asarray(vertices, np.float64).take(np.asarray(faces), axis=0)
        self._triangles = Triangles(self._corners)
        centres, self._part_of, self._reach = _parts(self._corners, part_size)
        self._most = self._reach.max()
        self._centres = cKDTree(centres)
        self._discs = Discs(centres, self._triangles.normals[self._part_of], self._reach)

    def closest(
        self, points: Float[np.ndarray, "P 3"], exact_below: float = np.inf, beside: PointsBeside | None = None
    ) -> ClosestPoints:
        """The closest point of the mesh to each point.

        Args:
            points: Metres, finite.
            exact_below: Distances above this many metres may be too large; asking for less is faster. With 0 all are
            upper bounds.
            beside: Points with `points` as their owners; those are ruled out that may not be clear of the mesh.
        """
        points = np.asarray(points, np.float64)
        found = _Found(np.full(len(points), np.inf), np.zeros(len(points), np.int64), np.zeros((len(points), 3)))
        # For points close to the mesh one radius does for all; most may lie on it, where a small one does.
        close = exact_below if exact_below <= _AT_ONCE * self._most else self._most
        if beside is not None:
            close = max(close, beside.reach)
        rows = np.arange(len(points))
        if exact_below > close and beside is None:
            self._search(points, rows, _ON_IT * self._most, found)
            rows = np.flatnonzero(found.distance > _ON_IT * self._most)
            # Which of several equally close triangles is taken must not depend on what was tried before.
            found.distance[rows] = np.inf
        if close > 0:
            self._search(points, rows, close, found, beside)
        rows = np.flatnonzero(found.distance > close)
        first, part = self._centres.query(points.take(rows, axis=0), k=1)
        self._try(points, rows, self._part_of[part], first, found)
        if exact_below > close:
            # Each has an upper bound now; where even the closest centre is farther, a rough answer will do.
            rows = rows[first - self._most < exact_below]
            bound = np.minimum(found.distance[rows], exact_below)
            order = np.argsort(bound)
            rows, bound = rows[order], bound[order]
            start = 0
            while start < len(rows):
                end = int(np.searchsorted(bound, _SIMILAR * bound[start], side="right"))
                self._search(points, rows[start:end], bound[end - 1], found)
                start = end
        position = np.einsum("pk,pkc->pc", found.weights, self._corners.take(found.face, axis=0))
        return ClosestPoints(np.linalg.norm(points - position, axis=1), found.face, found.weights, position)

    def _search(
        self,
        points: np.ndarray,
        rows: np.ndarray,
        limit: float,
        found: "_Found",
        beside: PointsBeside | None = None,
    ) -> None:
        """Make distances up to `limit` exact."""
        if not len(rows):
            return
        radius = limit + self._most
        probes = points[rows[:: max(len(rows) // _PROBES, 1)]]
        pairs = self._centres.query_ball_point(probes, radius, return_length=True).mean()
        block = max(int(_PAIRS / max(pairs, 1.0)), 1)
        for start in range(0, len(rows), block):
            here = rows[start : start + block]
            tree = cKDTree(points.take(here, axis=0), balanced_tree=False, compact_nodes=False)
            near = tree.sparse_distance_matrix(self._centres, radius, output_type="ndarray")
            row, part, far = here[near["i"]], near["j"], near["v"]
            # The triangle of the closest centre is close to the closest triangle.
            closest = np.full(len(here), np.inf)
            np.minimum.at(closest, near["i"], far)
            first = far == closest[near["i"]]
            self._try(points, row[first], self._part_of[part[first]], far[first], found)
            if beside is not None:
                beside.rule_out(self._discs, row, part, far)
            left = (far - self._reach[part] < np.minimum(found.distance[row], limit)) & ~first
            self._try(points, row[left], self._part_of[part[left]], far[left], found)

    def _try(self, points: np.ndarray, row: np.ndarray, face: np.ndarray, far: np.ndarray, found: "_Found") -> None:
        """Take the triangle `face` for the point `row`, for each such pair, where it is closer than what is known."""
        squared, v, w = self._triangles.closest(points.take(row, axis=0), face)
        distance = np.sqrt(squared)
        closer = np.flatnonzero(distance < found.distance[row])
        np.minimum.at(found.distance, row[closer], distance[closer])
        closer = closer[distance[closer] == found.distance[row[closer]]]
        # Of several that are equally close the one with the closest centre is written last, and stays.
        closer = closer[np.argsort(-far[closer], kind="stable")]
        at = row[closer]
        found.face[at] = face[closer]
        found.weights[at] = np.stack([1 - v[closer] - w[closer], v[closer], w[closer]], axis=1)


class _Found(NamedTuple):
    """The closest that is known of each point so far; its arrays are written to."""

    distance: Float[np.ndarray, " P"]
    face: Int[np.ndarray, " P"]
    weights: Float[np.ndarray, "P 3"]


def _parts(
    corners: Float[np.ndarray, "F 3 3"], size: float
) -> tuple[Float[np.ndarray, "S 3"], Int[np.ndarray, " S"], Float[np.ndarray, " S"]]:
    """Triangles cut into n² similar parts each, none much larger than `size` times the median triangle.

    Returns:
        Centres of the parts, the triangle of each, and the farthest that a point of each is from its centre, metres.
    """
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    cuts = np.clip(np.ceil(radius / max(size * float(np.median(radius)), 1e-300)), 1, _MOST_CUTS).astype(np.int64)
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
