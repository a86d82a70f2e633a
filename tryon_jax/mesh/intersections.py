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
    corners = points[faces]
    pairs = _overlapping_boxes(corners.min(axis=1), corners.max(axis=1))
    same = faces[pairs[:, 0], :, None] == faces[pairs[:, 1], None, :]
    shared = same.sum(axis=(1, 2))
    apart = pairs[shared == 0]
    apart = apart[~_separated(corners, apart)]
    crossing = apart[_cross(corners[apart[:, 0]], corners[apart[:, 1]])]

    hinged, same = pairs[shared == 1], same[shared == 1]
    # With the shared corner first, what can cross away from it is the opposite edge of either triangle.
    left = _from_corner(corners[hinged[:, 0]], same.any(axis=2))
    right = _from_corner(corners[hinged[:, 1]], same.any(axis=1))
    folded = _edge_through(left[:, 1], left[:, 2], right) | _edge_through(right[:, 1], right[:, 2], left)
    found = np.concatenate([crossing, hinged[folded]])
    return found[np.lexsort((found[:, 1], found[:, 0]))]


def _overlapping_boxes(low: Float[np.ndarray, "F 3"], high: Float[np.ndarray, "F 3"]) -> Int[np.ndarray, "P 2"]:
    """Pairs of axis-aligned boxes that overlap, by a grid whose cells are about as large as the boxes."""
    extent = (high - low).max(axis=1)
    # The median serves meshes of mixed density; the floor keeps one huge box from filling millions of cells.
    size = max(1.5 * float(np.median(extent)), float(extent.max()) / 32, float(np.ptp(high, axis=0).max()) / 1e6, 1e-12)
    origin = low.min(axis=0)
    first, last = np.floor((low - origin) / size).astype(np.int64), np.floor((high - origin) / size).astype(np.int64)
    spans = last - first + 1
    counts = spans.prod(axis=1)
    box = np.repeat(np.arange(len(low)), counts)
    offset = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    span = spans[box]
    step = np.stack([offset // (span[:, 1] * span[:, 2]), offset // span[:, 2] % span[:, 1], offset % span[:, 2]], 1)
    cell = first[box] + step
    grid = last.max(axis=0) + 1
    key = (cell[:, 0] * grid[1] + cell[:, 1]) * grid[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    key, box = key[order], box[order]

    found = []
    start = np.arange(len(key))
    for shift in range(1, len(key)):
        start = start[start + shift < len(key)]
        start = start[key[start] == key[start + shift]]
        if len(start) == 0:
            break
        a, b = box[start], box[start + shift]
        # Boxes that overlap share many cells: the one with the lowest corner of what they share counts.
        home = np.maximum(first[a], first[b])
        here = (home[:, 0] * grid[1] + home[:, 1]) * grid[2] + home[:, 2] == key[start]
        a, b = a[here], b[here]
        overlap = ((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)
        found.append(np.stack([np.minimum(a, b)[overlap], np.maximum(a, b)[overlap]], axis=1))
    return np.concatenate(found) if found else np.zeros((0, 2), np.int64)


def _volume(
    a: Float[np.ndarray, "P 3"], b: Float[np.ndarray, "P 3"], c: Float[np.ndarray, "P 3"], d: Float[np.ndarray, "P 3"]
) -> Float[np.ndarray, " P"]:
    """Six times the signed volume of the tetrahedra a, b, c, d."""
    return np.einsum("nd,nd->n", np.cross(b - a, c - a), d - a)


def _separated(corners: Float[np.ndarray, "F 3 3"], pairs: Int[np.ndarray, "P 2"]) -> Bool[np.ndarray, " P"]:
    """Pairs where one triangle lies wholly on one side of the other's plane: most candidates, cheaply."""
    apart = np.zeros(len(pairs), bool)
    for one, other in ((0, 1), (1, 0)):
        plane, points = corners[pairs[:, one]], corners[pairs[:, other]]
        normal = np.cross(plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0])
        side = np.einsum("nd,nkd->nk", normal, points - plane[:, :1])
        apart |= (side > 0).all(axis=1) | (side < 0).all(axis=1)
    return apart


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


def _from_corner(corners: Float[np.ndarray, "P 3 3"], chosen: Bool[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3 3"]:
    """Triangles turned so that the chosen corner comes first."""
    turn = (np.argmax(chosen, axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(corners, turn[:, :, None], axis=1)
