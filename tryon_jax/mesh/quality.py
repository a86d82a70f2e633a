"""Quality of the triangles of a mesh: areas, angles, distortion."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

IntArray = np.ndarray


def signed_areas(points: Float[np.ndarray, "V 2"], faces: Int[IntArray, "F 3"]) -> Float[np.ndarray, " F"]:
    """Signed areas of triangles in the plane, positive when counter-clockwise."""
    a, b, c = (points.take(faces[:, k], axis=0) for k in range(3))
    u, v = b - a, c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def edge_lengths(points: Float[np.ndarray, "V D"], faces: Int[IntArray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Lengths of the edges 0→1, 1→2 and 2→0 of each triangle, in the plane or in space."""
    corners = points.take(faces, axis=0)
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)


def areas(points: Float[np.ndarray, "V D"], faces: Int[IntArray, "F 3"]) -> Float[np.ndarray, " F"]:
    """Unsigned areas of triangles, in the plane or in space."""
    corners = points.take(faces, axis=0)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    gram = (u * u).sum(1) * (v * v).sum(1) - (u * v).sum(1) ** 2
    return 0.5 * np.sqrt(np.maximum(gram, 0.0))


def angles(points: Float[np.ndarray, "V D"], faces: Int[IntArray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Angles at the corners of each triangle, radians."""
    edges = edge_lengths(points, faces)
    a, c, b = edges[:, 0], edges[:, 2], edges[:, 1]
    tiny = np.finfo(float).tiny

    def between(p: np.ndarray, q: np.ndarray, far: np.ndarray) -> np.ndarray:
        return np.arccos(np.clip((p * p + q * q - far * far) / np.maximum(2 * p * q, tiny), -1.0, 1.0))

    return np.stack([between(a, c, b), between(a, b, c), between(b, c, a)], axis=1)


def distortion(points: Float[np.ndarray, "V D"], faces: Int[IntArray, "F 3"]) -> Float[np.ndarray, " F"]:
    """Distortion of each triangle: longest edge / (2 √3 · inradius).

    It is 1 for an equilateral triangle, 2.0 for the isosceles triangle with angles 20°, 80°, 80°, and grows without
    bound as a triangle degenerates, whether by a short edge or by an obtuse angle. No unit.
    """
    edges = edge_lengths(points, faces)
    half = edges.sum(axis=1) / 2
    area = areas(points, faces)
    return edges.max(axis=1) * half / (2 * np.sqrt(3) * np.maximum(area, np.finfo(float).tiny))


@dataclass(frozen=True)
class MeshQuality:
    """Summary of a triangulation; areas in square metres, angles in degrees."""

    num_faces: int
    total_area: float
    mean_area: float
    area_variation: float
    """Standard deviation of the areas over their mean."""
    min_angle: float
    median_angle: float
    """Median over triangles of the smallest angle."""
    mean_distortion: float
    max_distortion: float


def measure_quality(points: Float[np.ndarray, "V D"], faces: Int[IntArray, "F 3"]) -> MeshQuality:
    """Measure a triangulation in the plane or in space; see `distortion` for what that number is."""
    area = areas(points, faces)
    smallest = np.degrees(angles(points, faces).min(axis=1))
    stretch = distortion(points, faces)
    return MeshQuality(
        num_faces=len(faces),
        total_area=float(area.sum()),
        mean_area=float(area.mean()),
        area_variation=float(area.std() / area.mean()),
        min_angle=float(smallest.min()),
        median_angle=float(np.median(smallest)),
        mean_distortion=float(stretch.mean()),
        max_distortion=float(stretch.max()),
    )
