"""Bring a triangle mesh to another density without leaving its surface (host side, NumPy).

Long edges are halved until the mesh is finer than asked for, then edges are collapsed, the shortest first, until it is
as coarse as asked for, and the vertices are evened out along the surface. Borders and holes stay.
"""

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.graph.coarsen import coarsen
from tryon_jax.mesh.closest_points import MeshSearch
from tryon_jax.mesh.topology import border_mask, directed_edges, edge_keys, unique_edges

_FINER = 0.55
_EVEN = 4.0
_MAX_SPLITS = 40


def mean_area(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float:
    """Mean triangle area, square metres."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(0.5 * np.linalg.norm(normal, axis=1).mean())


def resample(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], target_area: float, even_steps: int = 5
) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "M 3"]]:
    """A mesh of the same surface with triangles of `target_area` square metres on average.

    Args:
        vertices: Metres.
        faces: A manifold mesh, with or without borders.
        target_area: Mean area of the new triangles.
        even_steps: Rounds of evening out.

    Raises:
        ValueError: the area is not positive.
    """
    if not target_area > 0:
        raise ValueError(f"target_area = {target_area} must be positive")
    total = mean_area(vertices, faces) * len(faces)
    edge = np.sqrt(4.0 * target_area / np.sqrt(3.0))
    fine, fine_faces = split_long_edges(vertices, faces, _FINER * edge)
    # Euler: faces = 2 (vertices − χ) − border vertices, where χ stays and the border thins out with the edges.
    edges, counts = unique_edges(fine_faces, len(fine))
    euler = len(fine) - len(edges) + len(fine_faces)
    border = edges[counts == 1]
    outline = np.linalg.norm(fine[border[:, 0]] - fine[border[:, 1]], axis=1).sum() / edge
    count = round(0.5 * (total / target_area + outline) + euler)
    coarse = coarsen(fine, fine_faces, min(max(count, 3), len(fine)), length_weight=_EVEN)
    points, triangles = fine[coarse.kept], coarse.faces
    surface = MeshSearch(vertices, faces)
    for _ in range(even_steps):
        points = _even_out(points, triangles, surface)
    return points, triangles


def split_long_edges(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], longest: float
) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "M 3"]]:
    """Halve every edge longer than `longest` until none is left; the surface does not change.

    Args:
        vertices: Metres.
        faces: Triangles.
        longest: Length that no edge exceeds afterwards, metres.

    Returns:
        Vertices, the old ones first, and triangles.
    """
    points, triangles = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    for _ in range(_MAX_SPLITS):
        count = len(points)
        half = directed_edges(triangles)
        keys, inverse = np.unique(edge_keys(half, count), return_inverse=True)
        ends = np.stack([keys // count, keys % count], axis=1)
        length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        # The longest edge of each triangle at least as long as any other that is split: no slivers from short ones.
        per_face = length[inverse].reshape(3, -1)
        split = np.zeros(len(keys), bool)
        face = np.arange(len(triangles))
        worst = per_face.argmax(axis=0)
        split[inverse.reshape(3, -1)[worst, face][per_face[worst, face] > longest]] = True
        if not split.any():
            break
        middle = np.full(len(keys), -1)
        middle[split] = count + np.arange(split.sum())
        points = np.concatenate([points, points[ends[split]].mean(axis=1)])
        triangles = _split_faces(triangles, middle[inverse].reshape(3, -1).T, points)
    return points, triangles


def _split_faces(faces: np.ndarray, middle: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Triangles after midpoints (−1: none) were put on their edges 0→1, 1→2, 2→0."""
    number = (middle >= 0).sum(axis=1)
    parts = [faces[number == 0]]
    three = number == 3
    a, b, c = faces[three].T
    x, y, z = middle[three].T
    parts += [np.stack(t, axis=1) for t in ((a, x, z), (x, b, y), (z, y, c), (x, y, z))]
    for k in range(3):
        turn = [k, (k + 1) % 3, (k + 2) % 3]
        # One midpoint, on the edge from corner k.
        one = (number == 1) & (middle[:, k] >= 0)
        a, b, c = faces[one][:, turn].T
        x = middle[one, k]
        parts += [np.stack([a, x, c], axis=1), np.stack([x, b, c], axis=1)]
        # Two midpoints, none on the edge from corner k: of the quad that is left the shorter diagonal is taken.
        two = (number == 2) & (middle[:, k] < 0)
        a, b, c = faces[two][:, turn].T
        y, z = middle[two, turn[1]], middle[two, turn[2]]
        parts.append(np.stack([y, c, z], axis=1))
        first = np.linalg.norm(points[a] - points[y], axis=1) <= np.linalg.norm(points[b] - points[z], axis=1)
        near, far = first[:, None], ~first[:, None]
        parts.append(np.where(near, np.stack([a, b, y], axis=1), np.stack([a, b, z], axis=1)))
        parts.append(np.where(far, np.stack([b, y, z], axis=1), np.stack([a, y, z], axis=1)))
    return np.concatenate(parts)


def _even_out(points: np.ndarray, triangles: np.ndarray, surface: MeshSearch) -> np.ndarray:
    """Move inner vertices half way to the mean of their neighbours, along the surface, unless a triangle would flip."""
    count = len(points)
    edges, _ = unique_edges(triangles, count)
    row, column = np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([edges[:, 1], edges[:, 0]])
    degree = np.maximum(np.bincount(row, minlength=count), 1)
    mean = np.stack([np.bincount(row, points[column, i], minlength=count) / degree for i in range(3)], axis=1)
    wanted = surface.closest(points + 0.5 * (mean - points)).position
    border = border_mask(triangles, count)
    moved = np.where(border[:, None], points, wanted)
    before, after = (np.cross(p[triangles[:, 1]] - p[triangles[:, 0]], p[triangles[:, 2]] - p[triangles[:, 0]])
                     for p in (points, moved))  # fmt: skip
    flipped = np.einsum("fi,fi->f", before, after) < 0.5 * np.linalg.norm(before, axis=1) * np.linalg.norm(
        after, axis=1
    )
    moved[triangles[flipped]] = points[triangles[flipped]]
    return moved
