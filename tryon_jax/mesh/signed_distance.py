"""Exact signed distance to a closed triangle mesh (host side, float64).

The closest triangle is found among those with the closest centres. A bound says for which points a triangle with a
farther centre could still be closer; for those the search is widened until none can. The sign comes from the
angle-weighted pseudonormal of the closest face, edge or vertex, which is right everywhere outside and inside
(Baerentzen and Aanaes 2005).
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tryon_jax.mesh.topology import directed_edges, edge_keys

_FIRST, _CHUNK = 16, 200_000
# Barycentric weights below this are zero: the closest point is on an edge or a vertex.
_ZERO = 1e-9


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
        centres = corners.mean(axis=1)
        self._reach = float(np.linalg.norm(corners - centres[:, None], axis=2).max())
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
        open_rows, count = np.arange(len(points)), min(_FIRST, len(self.faces))
        while len(open_rows):
            # Where the closest centre is farther than bound + reach, so is every triangle.
            limit = np.full(len(open_rows), np.inf)
            for start in range(0, len(open_rows), max(_CHUNK // count, 1)):
                part = slice(start, start + max(_CHUNK // count, 1))
                rows = open_rows[part]
                far, candidates = self._centres.query(points[rows], k=count)
                far, candidates = far.reshape(len(rows), -1), candidates.reshape(len(rows), -1)
                self._try(points, rows, candidates, distance, face, weights)
                limit[part] = far[:, -1] - self._reach
            if count == len(self.faces):
                break
            open_rows = open_rows[(distance[open_rows] > limit) & (limit < exact_below)]
            count = min(4 * count, len(self.faces))
        corners = self.vertices[self.faces[face]]
        closest = np.einsum("pk,pkc->pc", weights, corners)
        offset = points - closest
        pseudo = self._pseudonormals(face, weights)
        sign = np.where(np.einsum("pc,pc->p", offset, pseudo) < 0, -1.0, 1.0)
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
        """Take the closest of the candidates of each row where it is closer than what is known."""
        corners = self.vertices[self.faces[candidates]]
        found = _closest_on_triangles(points[rows][:, None, :], corners)
        offset = np.einsum("nkc,nkci->nki", found, corners) - points[rows][:, None, :]
        squared = np.einsum("nki,nki->nk", offset, offset)
        best = np.argmin(squared, axis=1)
        own = np.arange(len(rows))
        new = np.sqrt(squared[own, best])
        closer = new < distance[rows]
        at = rows[closer]
        distance[at], face[at] = new[closer], candidates[own, best][closer]
        weights[at] = found[own, best][closer]

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


def _closest_on_triangles(p: np.ndarray, corners: np.ndarray) -> Float[np.ndarray, "N K 3"]:
    """Barycentric weights of the points of N × K triangles closest to N points [N, 1, 3]."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    ab, ac, ap = b - a, c - a, p - a
    aa, cc, ac_ab = (ab * ab).sum(-1), (ac * ac).sum(-1), (ab * ac).sum(-1)
    pb, pc = (ap * ab).sum(-1), (ap * ac).sum(-1)
    determinant = np.maximum(aa * cc - ac_ab**2, 1e-300)
    v, w = (cc * pb - ac_ab * pc) / determinant, (aa * pc - ac_ab * pb) / determinant
    inside = (v >= 0) & (w >= 0) & (v + w <= 1)
    zero = np.zeros_like(v)
    on_ab, on_ac = np.clip(pb / aa, 0, 1), np.clip(pc / cc, 0, 1)
    on_bc = np.clip((pc - pb + aa - ac_ab) / np.maximum(aa + cc - 2 * ac_ab, 1e-300), 0, 1)
    v = np.stack([v, on_ab, zero, 1 - on_bc])
    w = np.stack([w, zero, on_ac, on_bc])
    squared = v * v * aa + w * w * cc + 2 * v * w * ac_ab - 2 * v * pb - 2 * w * pc
    squared[0] = np.where(inside, -np.inf, np.inf)
    best = np.argmin(squared, axis=0)[None]
    v, w = np.take_along_axis(v, best, 0)[0], np.take_along_axis(w, best, 0)[0]
    return np.stack([1 - v - w, v, w], axis=-1)
