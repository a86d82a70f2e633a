"""The skin of a body in the few shapes from which distances in every other shape are interpolated (host side)."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from tryon_jax.body.shape_polynomial import ShapePolynomials, shape_polynomials
from tryon_jax.contact.collision_loss import VertexNeighbours, list_neighbours
from tryon_jax.contact.skin import extremity_vertices
from tryon_jax.types import ArrayLike, Body, pytree

_NEAR = 12
"""Neighbours of each body vertex in the search for the closest."""


@pytree
class SkinSamples:
    """A body in the S shapes of `polynomials`; made by `sample_skin`."""

    polynomials: ShapePolynomials
    vertices: Float[ArrayLike, "S W 3"]
    """Metres."""
    normals: Float[ArrayLike, "S W 3"]
    """Outward unit normals of the vertices."""
    counts: Bool[ArrayLike, " W"]
    """False for hands and feet, where simulated cloth slides over a smooth proxy."""
    neighbours: VertexNeighbours
    """The closest ones of each vertex."""


def sample_skin(body: Body, half_axes: tuple[float, ...]) -> SkinSamples:
    """The skin of `body` in shapes spread over an ellipse of betas.

    Args:
        body: The body.
        half_axes: Of the ellipse, standard deviations, one for each beta.
    """
    polynomials = shape_polynomials(half_axes)
    directions = np.asarray(body.shapedirs, np.float64)[..., : len(half_axes)]
    moved = np.einsum("vdb,sb->svd", directions, np.asarray(polynomials.betas, np.float64))
    vertices = np.asarray(body.v_template, np.float64)[None] + moved
    return SkinSamples(
        polynomials,
        vertices.astype(np.float32),
        _vertex_normals(vertices, np.asarray(body.faces)).astype(np.float32),
        ~extremity_vertices(body),
        list_neighbours(body, near=_NEAR, far=0),
    )


def _vertex_normals(vertices: Float[np.ndarray, "S W 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "S W 3"]:
    """Area-weighted unit normals of several shapes of one mesh."""
    corners = vertices[:, faces]
    across = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    rows, columns = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    gather = sp.csr_array((np.ones(len(rows)), (rows, columns)), shape=(vertices.shape[1], len(faces)))
    total = np.stack([gather @ of_one for of_one in across])
    return total / np.maximum(np.linalg.norm(total, axis=2, keepdims=True), 1e-300)
