"""Exact signed distance to a closed triangle mesh (host side, float64).

Triangles are cut into similar parts of about one size. The closest triangle is found among those of the parts with the
closest centres; a bound says for which points a part with a farther centre could still be closer, and for those the
search is widened until none can. The sign comes from the angle-weighted pseudonormal of the closest face, edge or
vertex, which is right everywhere outside and inside (Baerentzen and Aanaes 2005).
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tryon_jax.mesh.topology import directed_edges, edge_keys

_FIRST, _CHUNK = 8, 100_000
# Barycentric weights below this are zero: the closest point is on an edge or a vertex.
_ZERO = 1e-9
# Parts along an edge into which a triangle is cut at most.
_MOST_CUTS = 16


class ClosedSurface:
    """A closed, consistently oriented mesh prepared for distance queries."""

    def __init__(self, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> None:
        """Prepare search structures and pseudonormals; raises `ValueError` for a mesh that is not closed."""
        self.vertices = np.asarray(vertices, np.float64)
        self.faces = np.asarray(faces, np.int64)
        count = len(self.vertices)
        half = directed_edges(self.faces)
        keys, inverse, counts = np.unique(edge_keys(half, count), return_inverse=True, return_counts=True)
        if (counts != 2).any():
            raise ValueError(f"the surface must be closed, but {int((counts != 2).sum())} edges have not two faces")
        corners = self.vertices[self.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
        edge = np.zeros((len(keys), 3))
        np.add.at(edge, inverse, np.tile(normal, (3, 1)))
        at_vertex = np.zeros((count, 3))
        for k in range(3):
            a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
            cosine = (a * b).sum(1) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-300)
            np.add.at(at_vertex, self.faces[:, k], np.arccos(np.clip(cosine, -1, 1))[:, None] * normal)
        self.face_normals, self.vertex_normals = normal, at_vertex
        # Half-edge k of a face runs from corner k to corner k + 1.
        self.edge_normals = edge[inverse].reshape(3, len(self.faces), 3).swapaxes(0, 1)
        self._triangles = _Triangles(corners)
        centres, self._part_of, self._reach = _parts(corners)
        self._centres = cKDTree(centres)

    def closest(
        self, points: Float[np.ndarray, "P 3"], exact_below: float = np.inf
    ) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, "P 3"], Float[np.ndarray, "P 3"]]:
        """Signed distance (negative inside), closest point, and unit direction of growing distance, for each point.

        Distances above `exact_below` metres may be too large; asking for less is faster.
        """
        points = np.asarray(points, np.float64)
        distance = np.full(len(points), np.inf)
        face = np.zeros(len(points), np.int64)
        weights = np.zeros((len(points), 3))
        # Where even the closest centre is farther than that, a rough answer will do.
        first, part = self._centres.query(points, k=1)
        self._try(points, np.arange(len(points)), part[:, None], distance, face, weights)
        open_rows, count = np.flatnonzero(first - self._reach < exact_below), min(_FIRST, len(self._part_of))
        while len(open_rows):
            # Where the closest centre is farther than bound + reach, so is every triangle.
            limit = np.full(len(open_rows), np.inf)
            for start in range(0, len(open_rows), max(_CHUNK // count, 1)):
                chunk = slice(start, start + max(_CHUNK // count, 1))
                rows = open_rows[chunk]
                far, candidates = self._centres.query(points[rows], k=count)
                far, candidates = far.reshape(len(rows), -1), candidates.reshape(len(rows), -1)
                self._try(points, rows, candidates, distance, face, weights)
                limit[chunk] = far[:, -1] - self._reach
            if count == len(self._part_of):
                break
            open_rows = open_rows[(distance[open_rows] > limit) & (limit < exact_below)]
            count = min(4 * count, len(self._part_of))
        corners = self.vertices[self.faces[face]]
        closest = np.einsum("pk,pkc->pc", weights, corners)
        offset = points - closest
        pseudo = self._pseudonormals(face, weights)
        sign = np.where(np.einsum("pc,pc->p", offset, pseudo) < 0, -1.0, 1.0)
        distance = np.linalg.norm(offset, axis=1)
        away = np.where(distance[:, None] > _ZERO, sign[:, None] * offset, pseudo)
        away = away / np.maximum(np.linalg.norm(away, axis=1), 1e-300)[:, None]
        return sign * distance, closest, away

    def _try(
        self,
        points: np.ndarray,
        rows: np.ndarray,
        candidates: np.ndarray,
        distance: np.ndarray,
        face: np.ndarray,
        weights: np.ndarray,
    ) -> None:
        """Take the closest triangle of the candidate parts of each row where it is closer than what is known."""
        faces = self._part_of[candidates]
        squared, v, w = self._triangles.closest(points[rows], faces)
        own, best = np.arange(len(rows)), np.argmin(squared, axis=1)
        new = np.sqrt(squared[own, best])
        closer = new < distance[rows]
        at, taken = rows[closer], (own[closer], best[closer])
        distance[at], face[at] = new[closer], faces[taken]
        weights[at] = np.stack([1 - v[taken] - w[taken], v[taken], w[taken]], axis=1)

    def _pseudonormals(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        result = self.face_normals[face].copy()
        zero = weights < _ZERO
        for k in range(3):
            # On the edge opposite to corner k, which is half-edge k + 1.
            on = zero[:, k] & (zero.sum(axis=1) == 1)
            result[on] = self.edge_normals[face[on], (k + 1) % 3]
            at = zero[:, (k + 1) % 3] & zero[:, (k + 2) % 3]
            result[at] = self.vertex_normals[self.faces[face[at], k]]
        return result


def _parts(corners: Float[np.ndarray, "F 3 3"]) -> tuple[Float[np.ndarray, "S 3"], Int[np.ndarray, " S"], float]:
    """Triangles cut into n² similar parts each, none much larger than the median triangle.

    Returns:
        centres of the parts, the triangle of each, and the farthest that a point of a part is from its centre.
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
    return np.concatenate(centres), np.concatenate(owner), float((radius / cuts).max())


class _Triangles:
    """What the closest point on a triangle needs, coordinates first."""

    def __init__(self, corners: Float[np.ndarray, "F 3 3"]) -> None:
        a, b, c = (np.ascontiguousarray(corners[:, k].T) for k in range(3))
        self.origin, self.ab, self.ac = a, b - a, c - a
        self.aa, self.cc = _dot(self.ab, self.ab), _dot(self.ac, self.ac)
        self.mixed = _dot(self.ab, self.ac)
        self.determinant = np.maximum(self.aa * self.cc - self.mixed**2, 1e-300)
        self.bc = np.maximum(self.aa + self.cc - 2 * self.mixed, 1e-300)

    def closest(self, points: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "N K"]) -> tuple[np.ndarray, ...]:
        """Squared distances [N, K] of points from triangles, and the weights of corners b and c there."""
        ap = [points[:, k, None] - self.origin[k][faces] for k in range(3)]
        pb, pc = _dot(ap, [e[faces] for e in self.ab]), _dot(ap, [e[faces] for e in self.ac])
        aa, cc, mixed = self.aa[faces], self.cc[faces], self.mixed[faces]
        determinant = self.determinant[faces]
        v, w = (cc * pb - mixed * pc) / determinant, (aa * pc - mixed * pb) / determinant
        outside = np.nonzero((v < 0) | (w < 0) | (v + w > 1))
        # There the closest point is on one of the edges.
        pb_, pc_, aa_, cc_, mixed_ = pb[outside], pc[outside], aa[outside], cc[outside], mixed[outside]
        on_ab, on_ac = np.clip(pb_ / aa_, 0, 1), np.clip(pc_ / cc_, 0, 1)
        on_bc = np.clip((pc_ - pb_ + aa_ - mixed_) / self.bc[faces[outside]], 0, 1)
        zero = np.zeros_like(on_ab)
        edges = np.stack([on_ab, zero, 1 - on_bc]), np.stack([zero, on_ac, on_bc])
        best = np.argmin(_offset(*edges, aa_, cc_, mixed_, pb_, pc_), axis=0)[None]
        v[outside], w[outside] = (np.take_along_axis(edge, best, 0)[0] for edge in edges)
        squared = _dot(ap, ap) + _offset(v, w, aa, cc, mixed, pb, pc)
        return np.maximum(squared, 0.0), v, w


def _offset(v: Any, w: Any, aa: Any, cc: Any, mixed: Any, pb: Any, pc: Any) -> np.ndarray:
    """Squared distance of a point from a + v ab + w ac, less that from a."""
    return v * v * aa + w * w * cc + 2 * (v * w * mixed - v * pb - w * pc)


def _dot(a: Any, b: Any) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
