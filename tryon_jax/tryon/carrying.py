"""Device side, pure: a user's own mesh moves with the evenly spaced one that the networks see."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from tryon_jax.tryon.garment import Garment
from tryon_jax.types import EXACT, ArrayLike


def move_with_graph(
    garment: Garment, moved: Float[Array, "*batch N 3"], mean: Float[Array, "N 3"]
) -> Float[Array, "*batch M 3"]:
    """Vertices of the user's own mesh when the graph's have moved from `mean`; of the graph where there is no other.

    Args:
        garment: From `prepare`.
        moved: Vertices of the graph, metres.
        mean: Where they were, metres.

    Returns:
        Vertices, metres.
    """
    own = garment.own
    if own is None:
        return moved
    shift = (moved - mean.reshape((1,) * (moved.ndim - 2) + mean.shape))[..., jnp.asarray(own.carriers), :]
    carried = jnp.einsum("mk,...mkc->...mc", jnp.asarray(own.weights), shift, precision=EXACT)
    return carried + jnp.asarray(own.vertices).reshape((1,) * (moved.ndim - 2) + own.vertices.shape)


def carry_values(garment: Garment, values: Float[ArrayLike, " N *rest"]) -> Float[Array, " M *rest"]:
    """Values at the graph's vertices, interpolated at those of the user's own mesh; themselves where there is no other.

    Args:
        garment: From `prepare`.
        values: At each vertex of the graph.
    """
    own = garment.own
    if own is None:
        return jnp.asarray(values)
    near = jnp.asarray(values)[jnp.asarray(own.carriers)]
    return jnp.einsum("mk,mk...->m...", jnp.asarray(own.weights), near, precision=EXACT)
