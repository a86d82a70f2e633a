"""Where a triangle mesh passes through itself (host side, float64).

Candidates come from a uniform grid, crossings from signs of tetrahedron volumes (Guigue and Devillers 2003 use the same
predicates). Two triangles cross when an edge of one passes through the other. Triangles that share a corner can still
cross, away from it; triangles that share an edge cannot unless they are folded flat, which is not counted, and neither
are triangles that overlap in one plane.
"""

import numpy as np
from jaxtyping import Bool, Float, Int


def self_intersecting_faces(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Bool[np.ndarray, " F"]:
    """Mark the faces that cross another face of the same mesh."""
    marked = np.zeros(len(faces), bool)
    marked[self_intersections(vertices, faces).ravel()] = True
    return marked


def self_intersections(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "P 2"]:
    """Pairs of faces that cross each other, the smaller index first.

    Raises `ValueError` when a vertex is not finite or a face names a vertex that does not exist.
    """
    points = np.asarray(vertices, np.float64)
    if not np.isfinite(points).all():
        raise ValueError(f"vertices must be finite, {int((~np.isfinite(points)).any(1).sum())} are not")
    if len(faces) == 0:
        return np.zeros((0, 2), np.int64)
    if faces.min() < 0 or faces.max() >= len(points):
        raise ValueError(f"faces must index {len(points)} vertices, but they run from {faces.min()} to {faces.max()}")
    faces = np.asarray(faces, np.int64)
    # Components first wherever there are many pairs: NumPy is fast along long rows.
    columns = np.ascontiguousarray(points.T)
    at = columns.take(faces.T, axis=1)
    pairs = _overlapping_boxes(at.min(axis=1), at.max(axis=1))
    left, right = (faces.T.take(side, axis=1) for side in pairs)
    same = np.array([[one == other for other in right] for one in left])
    shared = same.reshape(9, -1).view(np.int8).sum(axis=0, dtype=np.int8)
    disjoint = shared == 0
    unclear = ~_on_one_side(columns, left[:, disjoint], right[:, disjoint])
    apart = pairs[:, disjoint].T[unclear]
    crossing = apart[_cross(points[faces[apart[:, 0]]], points[faces[apart[:, 1]]])]

    hinged = shared == 1
    pairs, same = pairs[:, hinged], same[:, :, hinged]
    # With the shared corner first, what can cross away from it is the opposite edge of either triangle.
    left = _from_corner(faces, pairs[0], np.logical_or.reduce(same, axis=1))
    right = _from_corner(faces, pairs[1], np.logical_or.reduce(same, axis=0))
    unclear = ~_on_one_side(columns, left, right, shared=1)
    left, right = (points[side.T[unclear]] for side in (left, right))
    folded = _edge_through(left[:, 1], left[:, 2], right) | _edge_through(right[:, 1], right[:, 2], left)
    found = np.concatenate([crossing, pairs.T[unclear][folded]])
    return found[np.lexsort((found[:, 1], found[:, 0]))]


def _overlapping_boxes(low: Float[np.ndarray, "3 F"], high: Float[np.ndarray, "3 F"]) -> Int[np.ndarray, "2 P"]:
    """Pairs of axis-aligned boxes that overlap, by a grid whose cells are about as large as the boxes."""
    extent = (high - low).max(axis=0)
    # The median serves meshes of mixed density; the floor keeps one huge box from filling millions of cells.
    size = max(1.5 * float(np.median(extent)), float(extent.max()) / 32, float(np.ptp(high, axis=1).max()) / 1e6, 1e-12)
    origin = low.min(axis=1, keepdims=True)
    first, last = ((side - origin) // size for side in (low, high))
    first, last = first.astype(np.int64), last.astype(np.int64)
    grid = last.max(axis=1) + 1
    box, step = _cells(last - first + 1)
    key = _number(first, grid).take(box) + _number(step, grid)
    order = np.argsort(key, kind="stable")
    key, box = key[order], box[order]

    # Boxes of one cell are neighbours in this order, however many there are.
    starts, start = [], np.arange(len(key))
    while len(start):
        shift = len(starts) + 1
        start = start[: np.searchsorted(start, len(key) - shift)]
        start = start[key.take(start) == key.take(start + shift)]
        starts.append(start)
    left = np.concatenate([np.zeros(0, np.int64), *starts])
    right = left + np.repeat(np.arange(len(starts)) + 1, [len(start) for start in starts])
    cell, a, b = key.take(left), box.take(left), box.take(right)
    for low_side, high_side in zip(low, high, strict=True):
        overlap = (low_side.take(a) <= high_side.take(b)) & (low_side.take(b) <= high_side.take(a))
        cell, a, b = cell[overlap], a[overlap], b[overlap]
    # Boxes that overlap share many cells: the one with the lowest corner of what they share counts.
    home = _number(np.maximum(first.take(a, axis=1), first.take(b, axis=1)), grid) == cell
    a, b = a[home], b[home]
    return np.stack([np.minimum(a, b), np.maximum(a, b)])


def _cells(spans: Int[np.ndarray, "3 F"]) -> tuple[Int[np.ndarray, " C"], Int[np.ndarray, "3 C"]]:
    """Every cell of boxes that span so many cells along each axis: its box, and its steps from the box's first cell."""
    counts = spans.prod(axis=0)
    box = np.repeat(np.arange(len(counts)), counts)
    offset = np.arange(len(box)) - np.repeat(np.cumsum(counts) - counts, counts)
    along_y, along_z = spans[1].take(box), spans[2].take(box)
    rest = offset // along_z
    return box, np.stack([rest // along_y, rest % along_y, offset % along_z])


def _number(cell: Int[np.ndarray, "3 C"], grid: Int[np.ndarray, " 3"]) -> Int[np.ndarray, " C"]:
    return (cell[0] * grid[1] + cell[1]) * grid[2] + cell[2]


def _on_one_side(
    points: Float[np.ndarray, "3 V"], left: Int[np.ndarray, "3 P"], right: Int[np.ndarray, "3 P"], shared: int = 0
) -> Bool[np.ndarray, " P"]:
    """Pairs where one triangle lies wholly on one side of the other's plane, but for their first corner if `shared`."""
    corners = [[points.take(corner, axis=1) for corner in side] for side in (left, right)]
    clear = np.zeros(left.shape[1], bool)
    for (origin, *others), opposite in (corners, corners[::-1]):
        (ax, ay, az), (bx, by, bz) = (corner - origin for corner in others)
        normal = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        offsets = (corner - origin for corner in opposite[shared:])
        heights = [normal[0] * x + normal[1] * y + normal[2] * z for x, y, z in offsets]
        clear |= np.logical_and.reduce([height > 0 for height in heights])
        clear |= np.logical_and.reduce([height < 0 for height in heights])
    return clear


def _volume(
    a: Float[np.ndarray, "P 3"], b: Float[np.ndarray, "P 3"], c: Float[np.ndarray, "P 3"], d: Float[np.ndarray, "P 3"]
) -> Float[np.ndarray, " P"]:
    """Six times the signed volume of the tetrahedra a, b, c, d."""
    return np.einsum("nd,nd->n", np.cross(b - a, c - a), d - a)


def _edge_through(
    start: Float[np.ndarray, "P 3"], end: Float[np.ndarray, "P 3"], triangle: Float[np.ndarray, "P 3 3"]
) -> Bool[np.ndarray, " P"]:
    """Whether the segment passes through the triangle, its border included."""
    a, b, c = triangle[:, 0], triangle[:, 1], triangle[:, 2]
    pierced = _volume(a, b, c, start) * _volume(a, b, c, end) < 0
    # Few edges pass through the plane.
    start, end, a, b, c = (points[pierced] for points in (start, end, a, b, c))
    turns = np.stack([_volume(start, end, a, b), _volume(start, end, b, c), _volume(start, end, c, a)], axis=1)
    # Barycentric coordinates up to their common factor. Where the two halves of a symmetric body meet, edges pass
    # exactly through edges: without the tolerance rounding would decide, and mostly against both triangles.
    total = turns.sum(axis=1, keepdims=True)
    pierced[pierced] = (turns * np.sign(total) >= -1e-9 * np.abs(total)).all(axis=1)
    return pierced


def _cross(left: Float[np.ndarray, "P 3 3"], right: Float[np.ndarray, "P 3 3"]) -> Bool[np.ndarray, " P"]:
    """Whether an edge of either triangle passes through the other."""
    crossing = np.zeros(len(left), bool)
    for edge in range(3):
        after = (edge + 1) % 3
        crossing |= _edge_through(left[:, edge], left[:, after], right)
        crossing |= _edge_through(right[:, edge], right[:, after], left)
    return crossing


def _from_corner(
    faces: Int[np.ndarray, "F 3"], index: Int[np.ndarray, " P"], chosen: Bool[np.ndarray, "3 P"]
) -> Int[np.ndarray, "3 P"]:
    """Corners of these faces, turned so that the chosen one comes first."""
    turn = np.argmax(chosen, axis=0)
    return np.stack([faces.ravel().take(3 * index + (turn + k) % 3) for k in range(3)])
