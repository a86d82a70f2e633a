"""The closest point of a triangle, on the host; `contact.closest_points` has the same for the device."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

# A triangle whose squared doubled area is below this share of the product of its squared edges has no inside.
_FLAT = 1e-14
_TINY = 1e-300
# Pairs at a time: their arrays stay in the processor's cache.
_CHUNK = 8192


class Triangles:
    """Triangles with the products that closest points need, made once."""

    def __init__(self, corners: Float[np.ndarray, "F 3 3"]) -> None:
        """Prepare triangles with these corners, metres; triangles without area are allowed."""
        a, b, c = (np.asarray(corners, np.float64)[:, k].T for k in range(3))
        ab, ac = b - a, c - a
        aa, cc, mixed = _dot(ab, ab), _dot(ac, ac), _dot(ab, ac)
        determinant = aa * cc - mixed**2
        across = np.stack([ab[1] * ac[2] - ab[2] * ac[1], ab[2] * ac[0] - ab[0] * ac[2], ab[0] * ac[1] - ab[1] * ac[0]])
        size = np.where(determinant > _FLAT * aa * cc, np.sqrt(_dot(across, across)), np.inf)
        self.normals: Float[np.ndarray, "F 3"] = (across / size).T
        """Of unit length; zero where a triangle has no area."""
        # Nothing compares with NaN: the projection onto a triangle without area counts as outside.
        determinant = np.where(determinant > _FLAT * aa * cc, determinant, np.nan)
        bc = np.maximum(aa + cc - 2 * mixed, _TINY)
        # One row for each triangle, so that one is read from one place.
        self._rows = np.stack([*a, *ab, *ac, aa, cc, mixed, determinant, bc], axis=1)

    def closest(
        self, points: Float[np.ndarray, "N 3"], triangle: Int[np.ndarray, " N"]
    ) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
        """The point closest to each point on a triangle.

        Args:
            points: Metres.
            triangle: Index of the triangle of each point.

        Returns:
            Squared distances, square metres, and the barycentric weights of the corners b and c.
        """
        squared, v, w = np.empty((3, len(triangle)))
        for start in range(0, len(triangle), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            squared[chunk], v[chunk], w[chunk] = self._closest(points[chunk].T, triangle[chunk])
        return squared, v, w

    def _closest(self, point: np.ndarray, triangle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        row = np.ascontiguousarray(self._rows.take(triangle, axis=0).T)
        ap = [point[k] - row[k] for k in range(3)]
        pb, pc = _dot(ap, row[3:6]), _dot(ap, row[6:9])
        aa, cc, mixed, determinant, bc = row[9:]
        v, w = (cc * pb - mixed * pc) / determinant, (aa * pc - mixed * pb) / determinant
        outside = np.flatnonzero(~((v >= 0) & (w >= 0) & (v + w <= 1)))
        # There the closest point is on one of the edges.
        pb_, pc_, aa_, cc_, mixed_, bc_ = (x.take(outside) for x in (pb, pc, aa, cc, mixed, bc))
        on_ab = np.clip(pb_ / np.maximum(aa_, _TINY), 0, 1)
        on_ac = np.clip(pc_ / np.maximum(cc_, _TINY), 0, 1)
        on_bc = np.clip((pc_ - pb_ + aa_ - mixed_) / bc_, 0, 1)
        zero = np.zeros_like(on_ab)
        edges = np.stack([on_ab, zero, 1 - on_bc]), np.stack([zero, on_ac, on_bc])
        best = np.argmin(_offset(*edges, aa_, cc_, mixed_, pb_, pc_), axis=0), np.arange(len(outside))
        v[outside], w[outside] = edges[0][best], edges[1][best]
        return np.maximum(_dot(ap, ap) + _offset(v, w, aa, cc, mixed, pb, pc), 0.0), v, w


def _offset(v: Any, w: Any, aa: Any, cc: Any, mixed: Any, pb: Any, pc: Any) -> np.ndarray:
    """Squared distance of a point from a + v ab + w ac, less that from a."""
    return v * v * aa + w * w * cc + 2 * (v * w * mixed - v * pb - w * pc)


def _dot(a: Any, b: Any) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
