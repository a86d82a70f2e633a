"""The paper's collision loss (section "Self-Supervised Learning of Body-Garment Collisions"), jittable and fast enough
to train on.

The closest body vertex is found by walking: each garment vertex starts at the body vertex that was closest on the
mean body and moves to the closest of that vertex's listed neighbours, a fixed number of times. Lists are made once
per body on the host. A flag says which walks had not come to rest; one at rest can still be in a local minimum, which
on simulated garments and shaken positions happened to at most 1.5 % of the vertices, and to none within 1 cm of the
skin, where alone it could change the loss. Brute force (`surface.closest_vertices_exact`), several hundred times as
expensive, is there to check against.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import cKDTree

from tryon_jax.types import ArrayLike, Body, pytree


@pytree
class VertexNeighbours:
    """For each body vertex, body vertices to try next; made by `list_neighbours`."""

    index: Int[ArrayLike, "V R"]


def list_neighbours(body: Body, near: int = 24, far: int = 8) -> VertexNeighbours:
    """Neighbours of each vertex of the mean body: the `near` closest ones, and `far` ones farther and farther away.

    The far ones, at ranks that double, let a walk cross gaps (from one leg to the other) and large distances.

    Args:
        body: The body.
        near: Number of closest vertices.
        far: Number of vertices farther away.
    """
    points = np.asarray(body.v_template)
    ranks = near * 2 ** np.arange(1, far + 1)
    ranks = np.minimum(ranks, len(points) - 1)
    _, index = cKDTree(points).query(points, k=int(max(ranks.max(initial=0), near)) + 1)
    return VertexNeighbours(np.concatenate([index[:, : near + 1], index[:, ranks]], axis=1).astype(np.int32))


def closest_vertices(
    neighbours: VertexNeighbours,
    body_vertices: Float[Array, "B 3"],
    points: Float[Array, "N 3"],
    start: Int[ArrayLike, " N"],
    steps: int = 3,
) -> tuple[Int[Array, " N"], Bool[Array, " N"]]:
    """Index of the body vertex closest to each point, and whether the search had converged there.

    Args:
        neighbours: From `list_neighbours`, for any shape of this body.
        body_vertices: The body as it is now, metres.
        points: Garment vertices, metres.
        start: Where each walk starts, such as the closest vertex on the mean body.
        steps: Moves at most; a point that would move once more is flagged.
    """
    body_vertices, points = jax.lax.stop_gradient((body_vertices, points))
    lists = jnp.asarray(neighbours.index)

    def step(vertex: Int[Array, " N"], _: None) -> tuple[Int[Array, " N"], Bool[Array, " N"]]:
        candidates = lists[vertex]
        offset = body_vertices[candidates] - points[:, None, :]
        best = jnp.argmin((offset * offset).sum(-1), axis=1)
        # The first in each list is the vertex itself.
        moved = jnp.take_along_axis(candidates, best[:, None], axis=1)[:, 0]
        return moved, moved == vertex

    vertex, rested = jax.lax.scan(step, jnp.asarray(start, lists.dtype), None, length=steps)
    return vertex, rested[-1]


def collision_depths(
    points: Float[Array, "N 3"],
    body_vertices: Float[Array, "B 3"],
    body_normals: Float[Array, "B 3"],
    closest: Int[Array, " N"],
    margin: float = 0.0,
) -> Float[Array, " N"]:
    """max(margin − n_k · (v_i − v_k), 0) for each garment vertex and its closest body vertex k, metres.

    The paper's L_collision has no margin. Differentiable in the points, and in the body where it depends on betas.

    Args:
        points: Garment vertices, metres.
        body_vertices: Metres.
        body_normals: Unit normals of the body's vertices.
        closest: The body vertex closest to each point.
        margin: Distance to keep, metres.
    """
    offset = points - body_vertices[closest]
    return jnp.maximum(margin - (body_normals[closest] * offset).sum(-1), 0.0)


def collision_loss(
    points: Float[Array, "N 3"],
    mask: Bool[ArrayLike, " N"],
    body_vertices: Float[Array, "B 3"],
    body_normals: Float[Array, "B 3"],
    neighbours: VertexNeighbours,
    start: Int[ArrayLike, " N"],
    margin: float = 0.0,
    steps: int = 3,
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """Mean collision depth over the real vertices of a padded garment, metres (the paper's L_collision).

    Args:
        points: Garment vertices with padding, metres.
        mask: Which of them are no padding.
        body_vertices: Metres.
        body_normals: Unit normals of the body's vertices.
        neighbours: Of the body's vertices, from `list_neighbours`.
        start: Body vertex at which the search for the closest one starts.
        margin: Distance to keep, metres.
        steps: Steps of the search.

    Returns:
        The loss, and measurements: "inside", the share of vertices inside the body; "deepest", metres; "unsettled",
        the share of vertices whose closest body vertex may be wrong (raise `steps` when it is not 0).
    """
    real = jnp.asarray(mask)
    count = jnp.maximum(real.sum(), 1)
    closest, rested = closest_vertices(neighbours, body_vertices, points, start, steps)
    depths = jnp.where(real, collision_depths(points, body_vertices, body_normals, closest, margin), 0.0)
    bare = jax.lax.stop_gradient(depths) - margin
    measured = {
        "inside": (real & (bare > 0)).sum() / count,
        "deepest": jnp.maximum(bare.max(), 0.0),
        "unsettled": (real & ~rested).sum() / count,
    }
    return depths.sum() / count, measured
