"""How far two drapes are apart: vertex by vertex, surface to surface, and in their normals."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tryon_jax.body.normals import vertex_normals
from tryon_jax.checks import check_finite, check_range
from tryon_jax.contact.closest_points import closest_point_on_triangle
from tryon_jax.mesh.quality import edge_lengths
from tryon_jax.types import EXACT

SPACING = 4e-3
"""Distance between samples of a surface, metres."""
_CANDIDATES = 6
_CHUNK = 32_768


class SurfaceSamples(NamedTuple):
    """Points spread over a triangle mesh, its vertices among them."""

    points: Float[np.ndarray, "S 3"]
    faces: Int[np.ndarray, " S"]
    """The face that each point lies on."""


def vertex_distances(
    first: Float[np.ndarray, "*batch V 3"], second: Float[np.ndarray, "*batch V 3"]
) -> Float[np.ndarray, "*batch V"]:
    """Distance of each vertex from the same vertex of another drape of the same mesh, metres."""
    return np.linalg.norm(np.asarray(first) - np.asarray(second), axis=-1)


def angle_between_normals(
    first: Float[np.ndarray, "V 3"], second: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, " V"]:
    """Angle between the two drapes' unit normals at each vertex, radians."""
    one, other = (np.asarray(vertex_normals(jnp.asarray(x), jnp.asarray(faces))) for x in (first, second))
    # The arc cosine loses half of the digits near zero; the chord does not.
    return 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(one - other, axis=1), 0.0, 1.0))


def sample_surface(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], spacing: float = SPACING
) -> SurfaceSamples:
    """A regular barycentric grid on every face, at most `spacing` metres between neighbours, no randomness.

    Raises:
        ValueError: the spacing is not positive, a vertex is not finite, or a face is so large that it would need
            more than 128 samples along an edge.
    """
    return _spread(vertices, faces, spacing, _grid)


def _spread(
    vertices: np.ndarray, faces: np.ndarray, spacing: float, pattern: Callable[[int], np.ndarray]
) -> SurfaceSamples:
    """Points at the pattern's barycentric weights on each face, cut into parts of edges up to `spacing`."""
    check_range("sample spacing", spacing, 1e-6, np.finfo(float).max, "m")
    points = np.asarray(check_finite("vertices", vertices), np.float64)
    divisions = np.maximum(np.ceil(edge_lengths(points, faces).max(axis=1) / spacing), 1).astype(int)
    check_range("samples along the longest edge", int(divisions.max(initial=1)), 1, 128)
    found, owners = [], []
    for count in np.unique(divisions):
        chosen = np.flatnonzero(divisions == count)
        weights = pattern(int(count))
        found.append(np.einsum("sk,fkc->fsc", weights, points[faces[chosen]]).reshape(-1, 3))
        owners.append(np.repeat(chosen, len(weights)))
    return SurfaceSamples(np.concatenate(found), np.concatenate(owners))


def _grid(count: int) -> Float[np.ndarray, "S 3"]:
    """Barycentric weights of the corners of count² equal parts of a triangle."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    i, j = i[i + j <= count], j[i + j <= count]
    return np.stack([count - i - j, i, j], axis=1) / count


def _centres(count: int) -> Float[np.ndarray, "S 3"]:
    """Barycentric weights of the centres of count² equal parts of a triangle."""
    i, j = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    up, down = i + j < count, i + j < count - 1
    first = np.stack([i[up] + 1 / 3, j[up] + 1 / 3], axis=1)
    second = np.stack([i[down] + 2 / 3, j[down] + 2 / 3], axis=1)
    both = np.concatenate([first, second]) / count
    return np.column_stack([1.0 - both.sum(axis=1), both])


def directed_distances(
    points: Float[np.ndarray, "P 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    spacing: float = SPACING,
) -> Float[np.ndarray, " P"]:
    """Distance of each point from a surface, metres.

    The faces are cut into parts of the size `spacing`; each point is projected exactly onto the faces of the parts
    with the closest centres. That can only be too large, and by less than the spacing.
    """
    centres = _spread(vertices, faces, spacing, _centres)
    return _project(np.asarray(points, np.float64), centres, cKDTree(centres.points), vertices, faces)


def hausdorff_distance(
    first: Float[np.ndarray, "V 3"],
    first_faces: Int[np.ndarray, "F 3"],
    second: Float[np.ndarray, "W 3"],
    second_faces: Int[np.ndarray, "G 3"],
    spacing: float = SPACING,
) -> float:
    """Symmetric Hausdorff distance between two surfaces, metres, by dense sampling of both (Cignoni et al. 1998).

    The meshes need nothing in common. It is the largest distance of any sample of either surface from the other one.
    """
    there = _farthest(sample_surface(first, first_faces, spacing), second, second_faces, spacing)
    return max(there, _farthest(sample_surface(second, second_faces, spacing), first, first_faces, spacing))


def _farthest(samples: SurfaceSamples, vertices: np.ndarray, faces: np.ndarray, spacing: float) -> float:
    target = _spread(vertices, faces, spacing, _centres)
    tree = cKDTree(target.points)
    # The distance from the closest centre bounds the distance from the surface: only the largest need projecting.
    bound = tree.query(samples.points)[0]
    order = np.argsort(bound)[::-1]
    largest, block = 0.0, 512
    for start in range(0, len(order), block):
        rows = order[start : start + block]
        if bound[rows[0]] <= largest:
            break
        largest = max(largest, float(_project(samples.points[rows], target, tree, vertices, faces).max()))
    return largest


def _project(
    points: np.ndarray, samples: SurfaceSamples, tree: cKDTree, vertices: np.ndarray, faces: np.ndarray
) -> Float[np.ndarray, " P"]:
    count = min(_CANDIDATES, len(samples.points))
    _, near = tree.query(points, k=count)
    corners = np.asarray(vertices, np.float64)[faces[samples.faces[near.reshape(len(points), count)]]]
    distances = np.empty(len(points))
    for start in range(0, len(points), _CHUNK):
        rows = slice(start, start + _CHUNK)
        # Relative to the point, so that float32 keeps micrometres; padded, so that few sizes are compiled.
        part = corners[rows] - points[rows, None, None]
        size = 512 if len(part) <= 512 else _CHUNK
        padded = np.concatenate([part, np.ones((size - len(part), *part.shape[1:]))])
        distances[rows] = np.asarray(_nearest_to_origin(jnp.asarray(padded)))[: len(part)]
    return distances


@jax.jit
def _nearest_to_origin(corners: Float[jax.Array, "P K 3 3"]) -> Float[jax.Array, " P"]:
    a, b, c = corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]
    weights = closest_point_on_triangle(jnp.zeros_like(a), a, b, c)
    closest = jnp.einsum("pkw,pkwc->pkc", weights, corners, precision=EXACT)
    return jnp.sqrt((closest * closest).sum(-1).min(axis=1))
