"""Triangles to pixels in NumPy, so that a picture needs neither a display, nor a GPU, nor a graphics driver.

Every step is one array operation over all triangles: first to the rows that each triangle covers, then to the pixels
of each row. Half a million covered pixels take a few hundredths of a second.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

# Widens each span by this many pixels so that rounding leaves no hole between neighbours.
_SLACK = 1e-6


@dataclass(frozen=True)
class Fragments:
    """The nearest triangle of every pixel."""

    face: Int[np.ndarray, "H W"]
    """Index of the triangle, -1 where there is none."""
    depth: Float[np.ndarray, "H W"]
    """Its depth, infinite where there is none."""
    points: Float[np.ndarray, "V 3"]
    """The screen points it was made from."""

    def corner_weights(
        self, faces: Int[np.ndarray, "F 3"], row: Int[np.ndarray, " N"], column: Int[np.ndarray, " N"]
    ) -> Float[np.ndarray, "N 3"]:
        """Barycentric weights of the triangle's corners at the centres of some covered pixels.

        The weights are affine on the screen: exact for parallel projection, and close for small triangles far away.

        Args:
            faces: Triangles of the scene.
            row: Of each pixel.
            column: Of each pixel.
        """
        a, b, c = (self.points[faces[self.face[row, column], k], :2] for k in range(3))
        p = np.stack([column + 0.5, row + 0.5], axis=1)
        whole = _cross(b - a, c - a)
        second = _cross(p - a, c - a) / whole
        third = _cross(b - a, p - a) / whole
        weights = np.clip(np.stack([1 - second - third, second, third], axis=1), 0, 1)
        return weights / weights.sum(axis=1, keepdims=True)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def rasterize(points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], height: int, width: int) -> Fragments:
    """Find the nearest triangle at the centre of every pixel.

    Args:
        points: x in pixels to the right, y in pixels downwards, depth (larger is farther).
        faces: triangles of either orientation; those seen edge on are left out.
        height: rows of the picture.
        width: columns of the picture.
    """
    points = points.astype(np.float64)
    # Split by coordinate at once: long one-dimensional arrays are several times faster here than rows of three.
    x, y, z = ([points[faces[:, k], axis] for k in range(3)] for axis in range(3))
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    top = np.maximum(np.ceil(np.minimum(np.minimum(y[0], y[1]), y[2]) - 0.5), 0).astype(np.int64)
    bottom = np.minimum(np.floor(np.maximum(np.maximum(y[0], y[1]), y[2]) - 0.5), height - 1).astype(np.int64)
    seen = np.flatnonzero((bottom >= top) & (np.abs(area) > 1e-9))
    x, y, z = ([values[seen] for values in axis] for axis in (x, y, z))
    area, top, rows = area[seen], top[seen], (bottom - top + 1)[seen]

    triangle, row = _expand(top, rows)
    low = np.full(len(row), -np.inf)
    high = np.full(len(row), np.inf)
    sign = np.sign(area)
    with np.errstate(divide="ignore", invalid="ignore"):
        for k in range(3):
            end = (k + 1) % 3
            rise = y[end] - y[k]
            slope = (x[end] - x[k]) / rise
            at = (x[k] - y[k] * slope)[triangle] + slope[triangle] * (row + 0.5)
            side = (rise * sign)[triangle]
            # The inside lies to the left of an edge that goes down (on a y-down screen, positive area).
            np.minimum(high, at, out=high, where=side > 0)
            np.maximum(low, at, out=low, where=side < 0)
    first = np.maximum(np.ceil(low - 0.5 - _SLACK), 0).astype(np.int64)
    last = np.minimum(np.floor(high - 0.5 + _SLACK), width - 1).astype(np.int64)
    span, column = _expand(first, np.maximum(last - first + 1, 0))

    dx = ((z[1] - z[0]) * (y[2] - y[0]) - (z[2] - z[0]) * (y[1] - y[0])) / area
    dy = ((z[2] - z[0]) * (x[1] - x[0]) - (z[1] - z[0]) * (x[2] - x[0])) / area
    offset = z[0] - dx * x[0] - dy * y[0]
    start = (offset[triangle] + dy[triangle] * (row + 0.5))[span]
    owner = triangle[span]
    depth = (start + dx[owner] * (column + 0.5)).astype(np.float32)

    pixel = row[span] * width + column
    nearest = np.full(height * width, np.inf, np.float32)
    np.minimum.at(nearest, pixel, depth)
    face = np.full(height * width, -1, np.int32)
    front = depth == nearest[pixel]
    face[pixel[front]] = seen[owner[front]]
    return Fragments(face.reshape(height, width), nearest.reshape(height, width), points)


def _expand(start: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each i the numbers start[i], start[i] + 1, …, count[i] of them: the i of each, and the numbers."""
    owner = np.repeat(np.arange(len(count)), count)
    before = np.cumsum(count) - count
    return owner, np.arange(len(owner)) + (start - before)[owner]
