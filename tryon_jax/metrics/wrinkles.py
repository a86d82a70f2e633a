"""Measures of wrinkles: size of what smoothing removes, how it varies with the body, and curvature."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from tryon_jax.graph.smoothing import HeatSmoother, smooth
from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.mesh.topology import hinges

_smooth = jax.jit(smooth)


def fine_part(smoother: HeatSmoother, drapes: Float[np.ndarray, "S N 3"]) -> Float[np.ndarray, "S N 3"]:
    """X − smooth(X) of drapes padded to the smoother's size, metres: what R_fine has to add."""
    columns = jnp.moveaxis(jnp.asarray(drapes), 0, 1)
    return np.asarray(drapes) - np.moveaxis(np.asarray(_smooth(smoother, columns)), 1, 0)


@dataclass(frozen=True)
class WrinkleComparison:
    """Fine parts of predicted drapes beside those of simulated ones, over several body shapes."""

    total: float
    """Energy (mean square length) of the fine part, predicted ÷ simulated."""
    varying: float
    """The same for its deviation from its mean over the shapes: wrinkles that come with the body."""
    correlation: float
    """Correlation of predicted with simulated deviations: 1 where the same folds come and go; 0 for a constant."""
    simulated: float
    """Root mean square length of the simulated fine part, metres."""
    simulated_varying: float
    """Root mean square length of its deviation, metres."""


def compare_wrinkles(predicted: Float[np.ndarray, "S V 3"], simulated: Float[np.ndarray, "S V 3"]) -> WrinkleComparison:
    """Compare fine parts (from `fine_part`, unpadded) of the same shapes.

    Raises:
        ValueError: fewer than two shapes, which have no varying part.
    """
    if len(predicted) < 2:
        raise ValueError(f"the varying part of wrinkles needs at least 2 body shapes, got {len(predicted)}")
    moves = [x - x.mean(axis=0, keepdims=True) for x in (predicted, simulated)]
    energy = [_energy(x) for x in (predicted, simulated)]
    varying = [_energy(x) for x in moves]
    product = float((moves[0] * moves[1]).sum(-1).mean())
    scale = np.sqrt(varying[0] * varying[1])
    # A constant does not vary with anything; rounding must not make a correlation of it.
    constant = varying[0] <= 1e-12 * varying[1]
    return WrinkleComparison(
        _ratio(energy[0], energy[1]),
        _ratio(varying[0], varying[1]),
        0.0 if constant or scale == 0.0 else product / float(scale),
        float(np.sqrt(energy[1])),
        float(np.sqrt(varying[1])),
    )


def _energy(offsets: np.ndarray) -> float:
    return float((offsets.astype(np.float64) ** 2).sum(-1).mean())


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0 else float("nan")


def fold_angles(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, " H"]:
    """Angle between the two faces at each inner edge, radians: 0 where flat, positive where it bulges outwards."""
    quads, pairs = hinges(faces, len(vertices))
    x = np.asarray(vertices, np.float64)
    corners = x[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    edge = x[quads[:, 1]] - x[quads[:, 0]]
    edge /= np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), 1e-300)
    one, other = normals[pairs[:, 0]], normals[pairs[:, 1]]
    return np.arctan2((np.cross(one, other) * edge).sum(1), (one * other).sum(1))


@dataclass(frozen=True)
class FoldStatistics:
    """How a drape is curved: angles per length, so that drapes of meshes of one density can be compared."""

    curvature: float
    """Area-weighted root mean square of the mean curvature, 1/m."""
    concave: float
    """Share of the surface that is curved inwards: valleys between folds."""
    sharp: float
    """90th percentile of the absolute curvature, 1/m."""


def fold_statistics(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> FoldStatistics:
    """Curvature statistics of a drape.

    The curvature at an inner edge is the mean curvature of its hinge: half the fold angle times the edge's length,
    over the third of both triangles that belongs to the edge (Grinspun et al. 2003). It is 1 / r on a sphere.
    """
    quads, pairs = hinges(faces, len(vertices))
    x = np.asarray(vertices, np.float64)
    corners = x[faces]
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    length = np.linalg.norm(x[quads[:, 1]] - x[quads[:, 0]], axis=1)
    area = doubled[pairs].sum(axis=1)
    curvature = 3.0 * fold_angles(vertices, faces) * length / np.maximum(area, 1e-300)
    weights = area / area.sum()
    order = np.argsort(np.abs(curvature))
    reached = np.searchsorted(np.cumsum(weights[order]), 0.9)
    return FoldStatistics(
        float(np.sqrt((weights * curvature**2).sum())),
        float(weights[curvature < 0].sum()),
        float(np.abs(curvature)[order[min(reached, len(order) - 1)]]),
    )


def self_intersecting_share(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float:
    """Share of faces that pass through another face of the same garment, 0 to 1."""
    return float(self_intersecting_faces(np.asarray(vertices, np.float64), np.asarray(faces)).mean())
