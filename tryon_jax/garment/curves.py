"""Plane curves as dense polylines: Bézier segments, arc length, uniform resampling, areas, crossings."""

import numpy as np
from jaxtyping import Bool, Float, Int

SEGMENT_POINTS = {"line": 2, "quadratic": 3, "cubic": 4}
"""Kinds of segments in a layout, with the number of points that define each."""

_SAMPLES = {"line": 2, "quadratic": 25, "cubic": 49}


def sample_segment(kind: str, points: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "N 2"]:
    """Points along a line, a quadratic or a cubic Bézier segment, ends included."""
    if kind == "line":
        return points
    t = np.linspace(0.0, 1.0, _SAMPLES[kind])[:, None]
    s = 1.0 - t
    if kind == "quadratic":
        return s**2 * points[0] + 2 * s * t * points[1] + t**2 * points[2]
    return s**3 * points[0] + 3 * s**2 * t * points[1] + 3 * s * t**2 * points[2] + t**3 * points[3]


def join_polylines(parts: list[np.ndarray]) -> Float[np.ndarray, "N 2"]:
    """One polyline from consecutive ones; repeated points (degenerate segments) are dropped."""
    line = np.concatenate(parts)
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return line[np.concatenate([[True], step > 1e-7])]


def arc_length(line: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, " N"]:
    """Distance along the polyline at each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def length(line: Float[np.ndarray, "N 2"]) -> float:
    """Length of a polyline."""
    return float(arc_length(line)[-1])


def point_at(line: Float[np.ndarray, "N 2"], fraction: Float[np.ndarray, " M"]) -> Float[np.ndarray, "M 2"]:
    """Points at fractions (0 to 1) of the arc length."""
    at = arc_length(line)
    where = fraction * at[-1]
    return np.stack([np.interp(where, at, line[:, 0]), np.interp(where, at, line[:, 1])], axis=1)


def resample_polyline(line: Float[np.ndarray, "N 2"], segments: int) -> Float[np.ndarray, "M 2"]:
    """`segments` + 1 points at equal distances along the polyline."""
    points = point_at(line, np.linspace(0.0, 1.0, segments + 1))
    points[0], points[-1] = line[0], line[-1]
    return points


def polygon_area(polygon: Float[np.ndarray, "N 2"]) -> float:
    """Signed area, positive for a counter-clockwise polygon."""
    x, y = polygon.T
    return float(0.5 * (x @ np.roll(y, -1) - np.roll(x, -1) @ y))


def inside_polygon(polygon: Float[np.ndarray, "N 2"], points: Float[np.ndarray, "P 2"]) -> Bool[np.ndarray, " P"]:
    """True for points inside a simple polygon (even-odd rule)."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    y = points[:, 1, None]
    spans = (a[:, 1] <= y) != (b[:, 1] <= y)
    rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    crossing = a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
    return (spans & (crossing > points[:, 0, None])).sum(axis=1) % 2 == 1


def first_crossing(polygon: Float[np.ndarray, "N 2"]) -> Int[np.ndarray, " 2"] | None:
    """Indices of two segments of a closed polygon that cross though they are not neighbours, or None."""
    n = len(polygon)
    a, b = polygon, np.roll(polygon, -1, axis=0)

    def orient(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    ab_c = orient(a[:, None], b[:, None], a[None])
    ab_d = orient(a[:, None], b[:, None], b[None])
    straddles = ab_c * ab_d < 0
    cross = straddles & straddles.T
    index = np.arange(n)
    gap = np.abs(index[:, None] - index[None])
    cross &= (gap > 1) & (gap < n - 1)
    hits = np.argwhere(cross)
    return hits[0] if len(hits) else None
