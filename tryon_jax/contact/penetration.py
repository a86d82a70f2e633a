"""How far a drape is inside the body, measured on the device: pure, jittable, for any bucket and any body shape."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.body.shape import shape_body
from tryon_jax.contact.closest_points import closest_faces, follow_faces, signed_distances
from tryon_jax.contact.collision_loss import VertexNeighbours, closest_vertices, list_neighbours
from tryon_jax.contact.surface import Surface, build_surface, move_surface
from tryon_jax.types import ArrayLike, Body, pytree


@pytree
class BodyContact:
    """The part of a distance query that does not depend on the body's shape; made once by `body_contact`."""

    surface: Surface
    neighbours: VertexNeighbours


@pytree
class PenetrationReport:
    """Where garment vertices are relative to the skin; one report for each body shape."""

    distance: Float[Array, "*batch N"]
    """Signed distance of each vertex from the closest point of the skin, metres, negative inside; 0 at padding."""
    inside: Float[Array, "*batch"]
    """Share of the real vertices that are inside, 0 to 1."""
    deepest: Float[Array, "*batch"]
    """Depth of the deepest vertex, metres; 0 when none is inside."""
    unsettled: Float[Array, "*batch"]
    """Share of the real vertices whose search for the skin had not converged."""


def body_contact(body: Body) -> BodyContact:
    """Topology and search lists of a body's skin, on the host.

    Raises:
        ValueError: the body's mesh is not closed.
    """
    return BodyContact(build_surface(np.asarray(body.v_template), np.asarray(body.faces)), list_neighbours(body))


def report_penetration(
    contact: BodyContact,
    body: Body,
    vertices: Float[Array, "B N 3"],
    betas: Float[Array, "B b"],
    start: Int[ArrayLike, " N"],
    mask: Bool[ArrayLike, " N"],
) -> PenetrationReport:
    """Distances of draped vertices from the skin of the bodies under them.

    The closest body vertex is searched as for the collision loss, from where the vertex was on the mean body; the
    closest triangle is then the one of those around it, or one that is reached from there across edges. Where the skin
    folds, another may be closer, so a distance is never too small. Differentiable in the vertices and betas.

    Args:
        contact: From `body_contact` of this body.
        body: The body.
        vertices: As `drape` returns them, padded, metres.
        betas: One body shape for each row of vertices.
        start: The body vertex closest to each garment vertex on the mean body, `garment.body_vertices`.
        mask: True for real vertices, `garment.mask`.
    """
    real = jnp.asarray(mask)
    count = jnp.maximum(real.sum(), 1)

    def of_one(points: Float[Array, "N 3"], shape: Float[Array, " b"]) -> PenetrationReport:
        skin = move_surface(contact.surface, shape_body(body, shape)[0])
        nearest, rested = closest_vertices(contact.neighbours, jnp.asarray(skin.vertices), points, start)
        face = follow_faces(skin, points, closest_faces(skin, points, nearest), hops=4)
        distance = jnp.where(real, signed_distances(skin, points, face), 0.0)
        return PenetrationReport(
            distance,
            (distance < 0).sum() / count,
            jnp.maximum(-distance.min(), 0.0),
            (real & ~rested).sum() / count,
        )

    return jax.vmap(of_one)(vertices, betas)
