"""Triangulation of one panel: fixed samples on the outline, an exact number of points inside, evenly spread.

The points inside start at random and settle under the repulsive bar forces of DistMesh (Persson and Strang,
"A simple mesh generator in MATLAB", SIAM Review 2004). The outline samples never move, so that the two sides of a
seam keep matching, and the number of points inside fixes the number of triangles and with it the mean area.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, cKDTree

from tryon_jax.garment.curves import inside_polygon, polygon_area
from tryon_jax.mesh.quality import angles, signed_areas
from tryon_jax.mesh.topology import directed_edges, edge_keys, unique_keys

JITTER = 0.7
"""Radius of the disk in which the points of the starting grid are jittered, as a share of its pitch."""

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
    return faces[_kept(points, faces, num_outline)]


def _kept(points: np.ndarray, faces: np.ndarray, num_outline: int) -> Bool[np.ndarray, " F"]:
    doubtful = np.flatnonzero((faces < num_outline).all(axis=1))
    corners = points[faces[doubtful]]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    keep = np.ones(len(faces), bool)
    keep[doubtful] = inside_polygon(points[:num_outline], corners.mean(axis=1)) & (area > FLAT * longest)
    return keep


def _scatter_inside(
    outline: np.ndarray, spacing: float, count: int, rng: np.random.Generator, jitter: float = JITTER
) -> np.ndarray:
    """Exactly `count` random points inside the outline, roughly `spacing` apart.

    A triangular grid, turned, shifted and jittered by so much that no direction of the grid is left: an unjittered
    one settles into a lattice with a grain, which is too easy a topology. It takes a fifth of the time of dart
    throwing.
    """
    hull = Delaunay(outline)
    inside = _kept(outline, hull.simplices, len(outline))
    fine = cKDTree(
        np.concatenate([outline + (np.roll(outline, -1, axis=0) - outline) * t for t in (0.0, 0.25, 0.5, 0.75)])
    )
    low, high = outline.min(axis=0), outline.max(axis=0)
    turn, shift = rng.random() * np.pi / 3, rng.random(2)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    pitch, points = spacing, outline[:0]
    for _ in range(6):
        reach = int(np.ceil(np.linalg.norm(high - low) / 2 / pitch)) + 2
        column, row = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-int(1.2 * reach), int(1.2 * reach) + 1))
        grid = np.stack([(column + 0.5 * (row % 2)).ravel(), (row * np.sqrt(3) / 2).ravel()], axis=1)
        points = (grid + shift) * pitch @ rotation + (low + high) / 2
        points = points[((points > low - pitch) & (points < high + pitch)).all(axis=1)]
        angle = 2 * np.pi * rng.random(len(points))
        radius = jitter * pitch * np.sqrt(rng.random(len(points)))
        points = points + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        where = hull.find_simplex(points)
        points = points[(where >= 0) & inside[where]]
        points = points[np.isinf(fine.query(points, distance_upper_bound=0.55 * spacing)[0])]
        if count <= len(points) <= 1.04 * count + 3:
            break
        pitch *= float(np.sqrt(max(len(points), 1) / (1.02 * count + 1)))
    if len(points) > count:
        crowd = cKDTree(np.concatenate([points, outline])).query(points, 2)[0][:, 1]
        last = np.argsort(crowd + 0.1 * spacing * rng.random(len(points)))
        points = np.delete(points, last[: len(points) - count], axis=0)
    while len(points) < count:
        points = _fill_gaps(outline, points, count - len(points), rng)
    return points


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
    first = second = close = beside = np.zeros(0, np.int64)
    for step in range(iterations):
        if step % refresh == 0:
            keys = unique_keys(edge_keys(directed_edges(delaunay_inside(points, fixed)), count))
            first, second = keys // count, keys % count
            near, at = tree.query(points[fixed:], distance_upper_bound=1.5 * spacing)
            close = np.flatnonzero(np.isfinite(near))
            close, beside = close + fixed, at[close]
        bar = [at.take(first) - at.take(second) for at in np.ascontiguousarray(points.T)]
        square = bar[0] ** 2 + bar[1] ** 2
        long = np.sqrt(square)
        rest = 1.2 * np.sqrt(square.mean())
        share = 0.2 * np.maximum(rest - long, 0.0) / long
        for k in range(2):
            force = share * bar[k]
            move = np.bincount(first, force, count) - np.bincount(second, force, count)
            points[fixed:, k] += move[fixed:]
        depth = ((points[close] - outline[beside]) * normals[beside]).sum(axis=1)
        # Nothing may cross the outline: what comes too near goes back to a third of an edge inside.
        push = np.maximum(0.35 * spacing - depth, 0.0)
        points[close] += push[:, None] * normals[beside]
    return points, delaunay_inside(points, fixed)


def triangulate(
    outline: Float[np.ndarray, "B 2"],
    count: int,
    rng: np.random.Generator,
    iterations: int = 40,
    refresh: int = 10,
    jitter: float = JITTER,
) -> tuple[Float[np.ndarray, "N 2"], Int[np.ndarray, "F 3"]]:
    """Triangulate a simple polygon with exactly `count` points inside it.

    Args:
        outline: samples of the outline, counter-clockwise, metres; they become the first points.
        count: number of points inside.
        rng: source of the topology: another state gives another triangulation.
        iterations: relaxation steps.
        refresh: steps between new triangulations.
        jitter: randomness of the start, see `JITTER`; 0 gives a regular lattice.

    Returns:
        points [N, 2], outline first, and counter-clockwise triangles [F, 3], F = B + 2 count − 2.

    Raises:
        ValueError: where no valid triangulation was found (an outline far too coarse for its shape).
    """
    spacing = edge_length(polygon_area(outline) / max(len(outline) + 2 * count - 2, 1))
    fault = ""
    for attempt in range(4):
        interior = _scatter_inside(outline, spacing, count, rng, jitter)
        points, faces = relax(outline, interior, spacing, iterations * (attempt + 1), refresh)
        fault = panel_fault(points, faces, len(outline))
        if not fault:
            return points, faces
    raise ValueError(f"cannot triangulate an outline of {len(outline)} samples with {count} points inside: {fault}")


def panel_fault(points: Float[np.ndarray, "N 2"], faces: Int[np.ndarray, "F 3"], num_outline: int) -> str:
    """What is wrong with the triangulation of a panel, or "" when it is exact.

    Args:
        points: Of the panel, metres; the outline's first.
        faces: Triangles.
        num_outline: How many points are the outline's.
    """
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
