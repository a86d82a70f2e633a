"""Unit normals of triangles and vertices, outward for counter-clockwise faces."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tryon_jax.types import ArrayLike


def _unit(vectors: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    # A zero vector stays zero with a zero gradient, where a plain division would give NaN in both.
    squared = jnp.sum(vectors**2, axis=-1, keepdims=True)
    positive = squared > 0
    return vectors * jnp.where(positive, 1 / jnp.sqrt(jnp.where(positive, squared, 1)), 0)


def _area_vectors(vertices: Float[ArrayLike, "V 3"], faces: Int[ArrayLike, "F 3"]) -> Float[Array, "F 3"]:
    corners = jnp.asarray(vertices)[jnp.asarray(faces)]
    return jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def face_normals(vertices: Float[ArrayLike, "V 3"], faces: Int[ArrayLike, "F 3"]) -> Float[Array, "F 3"]:
    """Unit normal of each triangle; zero for a triangle of no area."""
    return _unit(_area_vectors(vertices, faces))


def vertex_normals(vertices: Float[ArrayLike, "V 3"], faces: Int[ArrayLike, "F 3"]) -> Float[Array, "V 3"]:
    """Unit normal of each vertex: the area-weighted mean of its faces; zero where no face meets."""
    faces = jnp.asarray(faces)
    weighted = _area_vectors(vertices, faces)
    total = jnp.zeros_like(jnp.asarray(vertices))
    for corner in range(3):
        total = total.at[faces[:, corner]].add(weighted)
    return _unit(total)


def angle_weighted_normals(vertices: Float[ArrayLike, "V 3"], faces: Int[ArrayLike, "F 3"]) -> Float[Array, "V 3"]:
    """Sum at each vertex of its faces' unit normals times their angles there, not of unit length.

    Unlike the area-weighted mean it points outward from every point that is closest to the vertex.
    """
    faces = jnp.asarray(faces)
    corners = jnp.asarray(vertices)[faces]
    normal = face_normals(vertices, faces)
    total = jnp.zeros_like(jnp.asarray(vertices))
    for corner in range(3):
        first, second = (_unit(corners[:, (corner + k) % 3] - corners[:, corner]) for k in (1, 2))
        angle = jnp.arccos(jnp.clip((first * second).sum(-1, keepdims=True), -1.0, 1.0))
        total = total.at[faces[:, corner]].add(angle * normal)
    return total
