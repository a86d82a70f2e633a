"""Errors of a surface beside those of its vertices: of its edges, and of its normals.

The distance of vertices hardly tells a fold from its average; directions of the surface do.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.body.normals import face_normals
from tryon_jax.types import ArrayLike

_ROUNDED = 1e-3
"""Share of an edge's length below which its error is rounded off, so that the gradient stays finite."""


def edge_error(
    predicted: Float[Array, "N 3"], target: Float[Array, "N 3"], faces: Int[ArrayLike, "F 3"]
) -> Float[Array, ""]:
    """Mean distance between the vectors of edges, over the target's mean length of an edge (dimensionless).

    Args:
        predicted: One drape, metres.
        target: Where it should be, metres.
        faces: Triangles, padded with (0, 0, 0).
    """
    corners = jnp.asarray(faces)
    error, edge = (v[corners] - v[jnp.roll(corners, -1, axis=1)] for v in (predicted - target, target))
    real = _real(corners)
    length = _mean(jnp.sqrt((edge * edge).sum(axis=2) + jnp.finfo(edge.dtype).tiny).mean(axis=1), real)
    relative = error / length
    distance = jnp.sqrt((relative * relative).sum(axis=2) + _ROUNDED**2) - _ROUNDED
    return _mean(distance.mean(axis=1), real)


def normal_error(
    predicted: Float[Array, "N 3"], target: Float[Array, "N 3"], faces: Int[ArrayLike, "F 3"]
) -> Float[Array, ""]:
    """One minus the cosine between the normals of triangles, averaged over them (dimensionless).

    Args:
        predicted: As in `edge_error`.
        target: As in `edge_error`.
        faces: As in `edge_error`.
    """
    corners = jnp.asarray(faces)
    cosine = (face_normals(predicted, corners) * face_normals(target, corners)).sum(axis=1)
    return _mean(1.0 - cosine, _real(corners))


def _real(faces: Int[Array, "F 3"]) -> Bool[Array, " F"]:
    return (faces != 0).any(axis=1)


def _mean(values: Float[Array, " F"], real: Bool[Array, " F"]) -> Float[Array, ""]:
    return jnp.where(real, values, 0.0).sum() / real.sum()
