"""The closest point of a triangle, on the host; `contact.closest_points` has the same for the device."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

# A triangle whose squared doubled area is below this share of the product of its squared edges has no inside.
_FLAT = 1e-14
_TINY = 1e-300


class Triangles:
    """Triangles with the products that closest points need, made once.

    Arrays have the coordinate first, so that sums over coordinates are sums of whole arrays.
    """

    def __init__(self, corners: Float[np.ndarray, "F 3 3"]) -> None:
        """Prepare triangles with these corners, metres; triangles without area are allowed."""
        a, b, c = (np.ascontiguousarray(np.asarray(corners, np.float64)[:, k].T) for k in range(3))
        self._origin, self._ab, self._ac = a, b - a, c - a
        self._aa, self._cc = _dot(self._ab, self._ab), _dot(self._ac, self._ac)
        self._mixed = _dot(self._ab, self._ac)
        determinant = self._aa * self._cc - self._mixed**2
        # Nothing compares with NaN: the projection onto a triangle without area counts as outside.
        self._determinant = np.where(determinant > _FLAT * self._aa * self._cc, determinant, np.nan)
        self._bc = np.maximum(self._aa + self._cc - 2 * self._mixed, _TINY)

    def closest(
        self, points: Float[np.ndarray, "N 3"], triangle: Int[np.ndarray, "N K"]
    ) -> tuple[Float[np.ndarray, "N K"], Float[np.ndarray, "N K"], Float[np.ndarray, "N K"]]:
        """The point closest to each point on each of K triangles.

        Args:
            points: Metres.
            triangle: K indices of triangles for each point.

        Returns:
            Squared distances, square metres, and the barycentric weights of the corners b and c.
        """
        ap = [points[:, k, None] - self._origin[k][triangle] for k in range(3)]
        pb, pc = _dot(ap, [e[triangle] for e in self._ab]), _dot(ap, [e[triangle] for e in self._ac])
        aa, cc, mixed = self._aa[triangle], self._cc[triangle], self._mixed[triangle]
        determinant = self._determinant[triangle]
        v, w = (cc * pb - mixed * pc) / determinant, (aa * pc - mixed * pb) / determinant
        outside = np.nonzero(~((v >= 0) & (w >= 0) & (v + w <= 1)))
        # There the closest point is on one of the edges.
        pb_, pc_, aa_, cc_, mixed_ = pb[outside], pc[outside], aa[outside], cc[outside], mixed[outside]
        on_ab = np.clip(pb_ / np.maximum(aa_, _TINY), 0, 1)
        on_ac = np.clip(pc_ / np.maximum(cc_, _TINY), 0, 1)
        on_bc = np.clip((pc_ - pb_ + aa_ - mixed_) / self._bc[triangle[outside]], 0, 1)
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
