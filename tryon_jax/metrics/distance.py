"""How far two drapes are apart: vertex by vertex, surface to surface, and in their normals."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.checks import check_finite, check_range
from tryon_jax.mesh.closest_points import MeshSearch
from tryon_jax.mesh.normals import vertex_normals
from tryon_jax.mesh.quality import edge_lengths

SPACING = 4e-3
"""Distance between samples of a surface, metres."""


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
    """Angle between the two drapes' unit normals at each vertex, radians.

    Args:
        first: One drape, metres.
        second: Another drape of the same mesh, metres.
        faces: Triangles.
    """
    one, other = (vertex_normals(np.asarray(x), faces) for x in (first, second))
    # The arc cosine loses half of the digits near zero; the chord does not.
    return 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(one - other, axis=1), 0.0, 1.0))


def sample_surface(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], spacing: float = SPACING
) -> SurfaceSamples:
    """A regular barycentric grid on every face, at most `spacing` metres between neighbours, no randomness.

    Args:
        vertices: Metres.
        faces: Triangles.
        spacing: Largest distance between neighbouring samples, metres.

    Raises:
        ValueError: the spacing is not positive, a vertex is not finite, or a face is so large that it would need
            more than 128 samples along an edge.
    """
    check_range("sample spacing", spacing, 1e-6, np.finfo(float).max, "m")
    points = np.asarray(check_finite("vertices", vertices), np.float64)
    divisions = np.maximum(np.ceil(edge_lengths(points, faces).max(axis=1) / spacing), 1).astype(int)
    check_range("samples along the longest edge", int(divisions.max(initial=1)), 1, 128)
    found, owners = [], []
    for count in np.unique(divisions):
        chosen = np.flatnonzero(divisions == count)
        weights = _grid(int(count))
        found.append(np.einsum("sk,fkc->fsc", weights, points[faces[chosen]]).reshape(-1, 3))
        owners.append(np.repeat(chosen, len(weights)))
    return SurfaceSamples(np.concatenate(found), np.concatenate(owners))


def _grid(count: int) -> Float[np.ndarray, "S 3"]:
    """Barycentric weights of the corners of count² equal parts of a triangle."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    i, j = i[i + j <= count], j[i + j <= count]
    return np.stack([count - i - j, i, j], axis=1) / count


def directed_distances(
    points: Float[np.ndarray, "P 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, " P"]:
    """Distance of each point from a surface, metres, exact.

    Args:
        points: Metres.
        vertices: Of the surface, metres.
        faces: Triangles of the surface.
    """
    return MeshSearch(check_finite("vertices", vertices), faces).closest(points).distance


def hausdorff_distance(
    first: Float[np.ndarray, "V 3"],
    first_faces: Int[np.ndarray, "F 3"],
    second: Float[np.ndarray, "W 3"],
    second_faces: Int[np.ndarray, "G 3"],
    spacing: float = SPACING,
) -> float:
    """Symmetric Hausdorff distance between two surfaces, metres, by dense sampling of both (Cignoni et al. 1998).

    The meshes need nothing in common. It is the largest distance of any sample of either surface from the other one.

    Args:
        first: Vertices of one surface, metres.
        first_faces: Its triangles.
        second: Vertices of the other surface, metres.
        second_faces: Its triangles.
        spacing: Largest distance between neighbouring samples, metres.
    """
    there = _farthest(sample_surface(first, first_faces, spacing), MeshSearch(second, second_faces))
    return max(there, _farthest(sample_surface(second, second_faces, spacing), MeshSearch(first, first_faces)))


def _farthest(samples: SurfaceSamples, surface: MeshSearch) -> float:
    # A rough search bounds each distance from above: only the largest need an exact one.
    bound = surface.closest(samples.points, exact_below=0.0).distance
    order = np.argsort(bound)[::-1]
    largest, block = 0.0, 512
    for start in range(0, len(order), block):
        rows = order[start : start + block]
        if bound[rows[0]] <= largest:
            break
        largest = max(largest, float(surface.closest(samples.points[rows]).distance.max()))
    return largest
