"""Triangulation of one panel: fixed samples on the outline, an exact number of points inside, evenly spread.

The points inside start from a dart throw and settle under the repulsive bar forces of DistMesh (Persson and Strang,
"A simple mesh generator in MATLAB", SIAM Review 2004). The outline samples never move, so that the two sides of a
seam keep matching, and the number of points inside fixes the number of triangles and with it the mean area.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, cKDTree

from tryon_jax.garment.curves import inside_polygon, polygon_area
from tryon_jax.mesh.quality import angles, signed_areas
from tryon_jax.mesh.topology import directed_edges, edge_keys

FLAT = 1e-3
"""Outline triangles flatter than this (area over longest edge squared) come from collinear samples."""


def edge_length(area: float) -> float:
    """Edge of the equilateral triangle of that area, metres."""
    return float(np.sqrt(4 * area / np.sqrt(3)))


def interior_count(outline: Float[np.ndarray, "B 2"], target_area: float) -> int:
    """Points inside an outline that give triangles of mean area `target_area`: F = B + 2 I − 2."""
    faces = polygon_area(outline) / target_area
    return max(0, round((faces - len(outline) + 2) / 2))


def delaunay_inside(points: Float[np.ndarray, "N 2"], num_outline: int) -> Int[np.ndarray, "F 3"]:
    """Delaunay triangles within the outline (the first `num_outline` points, counter-clockwise), themselves
    counter-clockwise.

    Only triangles between three outline points can lie outside or be flat: collinear outline samples span triangles
    of no area, whose centroids fall on either side at random.
    """
    faces = Delaunay(points).simplices
    area = signed_areas(points, faces)
    faces = np.where((area < 0)[:, None], faces[:, [0, 2, 1]], faces)
    doubtful = np.flatnonzero((faces < num_outline).all(axis=1))
    corners = points[faces[doubtful]]
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    inside = inside_polygon(points[:num_outline], corners.mean(axis=1))
    keep = np.ones(len(faces), bool)
    keep[doubtful] = inside & (np.abs(area[doubtful]) > FLAT * longest)
    return faces[keep]


def _scatter_inside(outline: np.ndarray, spacing: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random points inside the outline, no two much closer than `spacing`, exactly `count` of them."""
    faces = delaunay_inside(outline, len(outline))
    area = signed_areas(outline, faces)
    tries = 6 * count + 50
    pick = rng.choice(len(faces), tries, p=area / area.sum())
    u, v = rng.random((2, tries))
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u)[:, None], np.where(fold, 1 - v, v)[:, None]
    a, b, c = (outline[faces[pick, k]] for k in range(3))
    points = a + u * (b - a) + v * (c - a)
    fine = np.concatenate([outline + (np.roll(outline, -1, axis=0) - outline) * t for t in (0.0, 0.25, 0.5, 0.75)])
    points = points[cKDTree(fine).query(points)[0] > 0.55 * spacing]
    points = points[_dart_throw(points, 0.72 * spacing)]
    if len(points) > count:
        crowd = cKDTree(np.concatenate([points, outline])).query(points, 2)[0][:, 1]
        points = np.delete(
            points, np.argsort(crowd + 0.15 * spacing * rng.random(len(points)))[: len(points) - count], 0
        )
    while len(points) < count:
        points = _fill_gaps(outline, points, count - len(points), rng)
    return points


def _dart_throw(points: np.ndarray, radius: float) -> Bool[np.ndarray, " N"]:
    """Which points remain when each, in order, is dropped if it is closer than `radius` to one already kept."""
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    pairs = np.sort(pairs, axis=1)
    keep = np.ones(len(points), bool)
    undecided = np.ones(len(points), bool)
    while len(pairs):
        # A point is kept once no earlier undecided point is near it; all that are near a kept one go.
        undecided[:] = False
        undecided[pairs[:, 1]] = True
        settled = ~undecided[pairs[:, 0]]
        keep[pairs[settled, 1]] = False
        pairs = pairs[keep[pairs[:, 0]] & keep[pairs[:, 1]]]
    return keep


def _fill_gaps(outline: np.ndarray, points: np.ndarray, missing: int, rng: np.random.Generator) -> np.ndarray:
    """Add up to `missing` points at the centroids of the largest triangles, no two of which share a corner."""
    every = np.concatenate([outline, points])
    faces = delaunay_inside(every, len(outline))
    corners = every[faces]
    centre = corners.mean(axis=1)
    room = np.linalg.norm(corners - centre[:, None], axis=2).min(axis=1)
    taken = np.zeros(len(every), bool)
    chosen = []
    for face in np.argsort(-room * (1 + 0.1 * rng.random(len(room)))):
        if len(chosen) == max(1, min(missing, (missing + 1) // 2 + 3)):
            break
        if not taken[faces[face]].any():
            taken[faces[face]] = True
            chosen.append(face)
    return np.concatenate([points, centre[chosen]])


def _inward_normals(outline: np.ndarray) -> np.ndarray:
    along = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def relax(
    outline: Float[np.ndarray, "B 2"],
    interior: Float[np.ndarray, "I 2"],
    spacing: float,
    iterations: int,
    refresh: int = 1,
) -> tuple[Float[np.ndarray, "N 2"], Int[np.ndarray, "F 3"]]:
    """Spread points evenly: every edge shorter than 1.2 times the mean pushes its ends apart.

    Args:
        outline: fixed samples, counter-clockwise, metres.
        interior: points that may move.
        spacing: edge length that the mesh should have, metres.
        iterations: force steps.
        refresh: force steps between new Delaunay triangulations.

    Returns:
        points (outline first) and counter-clockwise triangles.
    """
    fixed = len(outline)
    points = np.concatenate([outline, interior])
    count = len(points)
    normals = _inward_normals(outline)
    tree = cKDTree(outline)
    edges = np.zeros((0, 2), np.int64)
    for step in range(iterations):
        if step % refresh == 0:
            keys = np.unique(edge_keys(directed_edges(delaunay_inside(points, fixed)), count))
            edges = np.stack([keys // count, keys % count], axis=1)
        bar = points[edges[:, 0]] - points[edges[:, 1]]
        long = np.sqrt((bar * bar).sum(axis=1))
        rest = 1.2 * np.sqrt((long * long).mean())
        force = (np.maximum(rest - long, 0.0) / long)[:, None] * bar
        move = np.stack(
            [np.bincount(edges[:, 0], f, count) - np.bincount(edges[:, 1], f, count) for f in force.T], axis=1
        )
        points[fixed:] += 0.2 * move[fixed:]
        near, at = tree.query(points[fixed:], distance_upper_bound=spacing)
        close = np.flatnonzero(np.isfinite(near))
        at = at[close]
        depth = ((points[fixed + close] - outline[at]) * normals[at]).sum(axis=1)
        # Nothing may cross the outline: what comes too near goes back to a third of an edge inside.
        push = np.maximum(0.35 * spacing - depth, 0.0)
        points[fixed + close] += push[:, None] * normals[at]
    return points, delaunay_inside(points, fixed)


def triangulate(
    outline: Float[np.ndarray, "B 2"],
    count: int,
    rng: np.random.Generator,
    iterations: int = 40,
    refresh: int = 1,
) -> tuple[Float[np.ndarray, "N 2"], Int[np.ndarray, "F 3"]]:
    """Triangulate a simple polygon with exactly `count` points inside it.

    Args:
        outline: samples of the outline, counter-clockwise, metres; they become the first points.
        count: number of points inside.
        rng: source of the topology: another state gives another triangulation.
        iterations: relaxation steps.
        refresh: steps between new triangulations.

    Returns:
        points [N, 2], outline first, and counter-clockwise triangles [F, 3], F = B + 2 count − 2.

    Raises:
        ValueError: where no valid triangulation was found (an outline far too coarse for its shape).
    """
    spacing = edge_length(polygon_area(outline) / max(len(outline) + 2 * count - 2, 1))
    fault = ""
    for attempt in range(4):
        interior = _scatter_inside(outline, spacing, count, rng)
        points, faces = relax(outline, interior, spacing, iterations * (attempt + 1), refresh)
        fault = panel_fault(points, faces, len(outline))
        if not fault:
            return points, faces
    raise ValueError(f"cannot triangulate an outline of {len(outline)} samples with {count} points inside: {fault}")


def panel_fault(points: Float[np.ndarray, "N 2"], faces: Int[np.ndarray, "F 3"], num_outline: int) -> str:
    """What is wrong with the triangulation of a panel, or "" when it is exact."""
    count = len(points)
    if len(faces) != 2 * count - num_outline - 2:
        return f"{len(faces)} triangles in place of {2 * count - num_outline - 2}"
    keys, uses = np.unique(edge_keys(directed_edges(faces), count), return_counts=True)
    index = np.arange(num_outline)
    border = edge_keys(np.stack([index, (index + 1) % num_outline], axis=1), count)
    if not np.array_equal(np.sort(border), keys[uses == 1]) or uses.max() > 2:
        return "the border of the triangles is not the outline"
    area = signed_areas(points, faces)
    if abs(area.sum() - polygon_area(points[:num_outline])) > 1e-9 * area.sum() or area.min() <= 0:
        return "triangles overlap"
    if np.degrees(angles(points, faces).min()) < 5:
        return "a triangle has an angle under 5 degrees"
    return ""
