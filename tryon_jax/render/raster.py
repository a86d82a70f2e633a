"""Triangles to pixels in NumPy, so that a picture needs neither a display, nor a GPU, nor a graphics driver.

Every step is one array operation over all triangles: first to the rows that each triangle covers, then to the pixels
of each row. Half a million covered pixels take a few hundredths of a second.
"""

from collections.abc import Sequence
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
    shifts: Float[np.ndarray, " S"]
    """Where the rows were sampled, pixels to the right of the pixels' centres; repeated over the rows."""

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
        p = np.stack([column + 0.5 + self.shifts[row % len(self.shifts)], row + 0.5], axis=1)
        whole = _cross(b - a, c - a)
        second = _cross(p - a, c - a) / whole
        third = _cross(b - a, p - a) / whole
        weights = np.clip(np.stack([1 - second - third, second, third], axis=1), 0, 1)
        return weights / weights.sum(axis=1, keepdims=True)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def rasterize(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    height: int,
    width: int,
    shifts: Sequence[float] = (0.0,),
) -> Fragments:
    """Find the nearest triangle at one point of every pixel, its centre by default.

    Args:
        points: x in pixels to the right, y in pixels downwards, depth (larger is farther).
        faces: triangles of either orientation; those seen edge on are left out.
        height: rows of the picture.
        width: columns of the picture.
        shifts: how far to the right of the pixels' centres each row is sampled, pixels; repeated over the rows.
    """
    columns = np.array(shifts, np.float64)
    pixel, depth, triangle = _covered(points, faces, height, width, columns)
    nearest = _nearest(pixel, depth, height, width)
    face = np.full(height * width, -1, np.int32)
    front = depth == nearest[pixel]
    face[pixel[front]] = triangle[front]
    return Fragments(face.reshape(height, width), nearest.reshape(height, width), points.astype(np.float64), columns)


def nearest_depth(
    points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], height: int, width: int
) -> Float[np.ndarray, "H W"]:
    """Depth of the nearest triangle at the centre of every pixel, infinite where there is none; as `rasterize`.

    Args:
        points: x in pixels to the right, y in pixels downwards, depth (larger is farther).
        faces: triangles of either orientation; those seen edge on are left out.
        height: rows of the picture.
        width: columns of the picture.
    """
    pixel, depth, _ = _covered(points, faces, height, width, np.zeros(1))
    return _nearest(pixel, depth, height, width).reshape(height, width)


def _nearest(pixel: np.ndarray, depth: np.ndarray, height: int, width: int) -> np.ndarray:
    nearest = np.full(height * width, np.inf, np.float32)
    np.minimum.at(nearest, pixel, depth)
    return nearest


def _covered(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    height: int,
    width: int,
    shifts: Float[np.ndarray, " S"],
) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, " N"], Int[np.ndarray, " N"]]:
    """Every pixel that every triangle covers: its number, the triangle's depth there, and the triangle."""
    # Split by coordinate at once: long one-dimensional arrays are several times faster here than rows of three.
    x, y, z = ([axis[corner] for corner in faces.T] for axis in np.ascontiguousarray(points.T, np.float64))
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    top = np.maximum(np.ceil(np.minimum(np.minimum(y[0], y[1]), y[2]) - 0.5), 0).astype(np.int64)
    bottom = np.minimum(np.floor(np.maximum(np.maximum(y[0], y[1]), y[2]) - 0.5), height - 1).astype(np.int64)
    left = np.ceil(np.minimum(np.minimum(x[0], x[1]), x[2]) - 0.5 - shifts.max())
    right = np.floor(np.maximum(np.maximum(x[0], x[1]), x[2]) - 0.5 - shifts.min())
    # Most triangles of a small picture lie between the centres of its pixels.
    seen = np.flatnonzero((bottom >= top) & (right >= left) & (np.abs(area) > 1e-9))
    x, y, z = ([values[seen] for values in axis] for axis in (x, y, z))
    area, top, rows = area[seen], top[seen], (bottom - top + 1)[seen]

    triangle, row = _expand(top, rows)
    low = np.full(len(row), -np.inf)
    high = np.full(len(row), np.inf)
    sign = np.sign(area)
    middle = row + 0.5
    with np.errstate(divide="ignore", invalid="ignore"):
        for k in range(3):
            end = (k + 1) % 3
            rise = y[end] - y[k]
            slope = (x[end] - x[k]) / rise
            at = (x[k] - y[k] * slope)[triangle] + slope[triangle] * middle
            side = (rise * sign)[triangle]
            # The inside lies to the left of an edge that goes down (on a y-down screen, positive area).
            np.minimum(high, at, out=high, where=side > 0)
            np.maximum(low, at, out=low, where=side < 0)
    center = 0.5 + shifts[row % len(shifts)]
    first = np.maximum(np.ceil(low - center - _SLACK), 0).astype(np.int64)
    last = np.minimum(np.floor(high - center + _SLACK), width - 1).astype(np.int64)
    span, column = _expand(first, np.maximum(last - first + 1, 0))

    dx = ((z[1] - z[0]) * (y[2] - y[0]) - (z[2] - z[0]) * (y[1] - y[0])) / area
    dy = ((z[2] - z[0]) * (x[1] - x[0]) - (z[1] - z[0]) * (x[2] - x[0])) / area
    offset = z[0] - dx * x[0] - dy * y[0]
    # By rows first: what is computed for each pixel is two gathers, a product and a sum.
    start = offset[triangle] + dy[triangle] * middle + dx[triangle] * center
    depth = (start[span] + dx[triangle][span] * column).astype(np.float32)
    return (row * width)[span] + column, depth, seen[triangle][span]


def _expand(start: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each i the numbers start[i], start[i] + 1, …, count[i] of them: the i of each, and the numbers."""
    owner = np.repeat(np.arange(len(count)), count)
    before = np.cumsum(count) - count
    return owner, np.arange(len(owner)) + (start - before)[owner]
