"""Device side, pure: the mean drape of any design at a garment's fixed topology (section 2 of the paper)."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float

from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.tryon.carrying import move_with_graph
from tryon_jax.tryon.garment import Garment
from tryon_jax.tryon.model import TryOnModel
from tryon_jax.types import EXACT, ArrayLike


def with_design(model: TryOnModel, garment: Garment, design: Float[ArrayLike, " P"] | None) -> Garment:
    """The garment with M̄ of another design at its fixed topology; the garment itself where `design` is None.

    Args:
        model: Its R_mean.
        garment: From `prepare`.
        design: Parameters, metres.

    Raises:
        ValueError: the garment was not made from a design.
    """
    if design is None:
        return garment
    mean = mean_drape(model, garment, design)
    own = garment.own
    if own is not None:
        own = dataclasses.replace(own, vertices=move_with_graph(garment, mean, jnp.asarray(garment.graph.vertices)))
    moved = garment.with_vertices(mean)
    return dataclasses.replace(moved, design=jnp.asarray(design), own=own, rest=_rest_of(garment, moved))


def _rest_of(garment: Garment, moved: Garment) -> Float[Array, " E"] | None:
    """Rest lengths when M̄ is that of another design: edges of the pattern grow as those of M̄ do; metres."""
    if garment.edges is None or garment.rest is None:
        return None
    first, second = jnp.asarray(garment.edges).T

    def length(of: Garment) -> Float[Array, " E"]:
        points = jnp.asarray(of.graph.vertices)
        return jnp.sqrt(((points[second] - points[first]) ** 2).sum(-1) + 1e-8)

    return jnp.asarray(garment.rest) * length(moved) / length(garment)


def mean_drape(model: TryOnModel, garment: Garment, design: Float[ArrayLike, " P"]) -> Float[Array, "N 3"]:
    """M̄ = W · R_mean(p) at the garment's fixed topology, differentiable in the design; padded vertices are zero.

    Args:
        model: Its R_mean.
        garment: From `prepare`.
        design: Parameters, metres.

    Returns:
        Vertices, metres.

    Raises:
        ValueError: the garment was not made from a design.
    """
    if garment.template_vertices is None or garment.template_weights is None:
        raise ValueError("this garment is a mesh without a design: its mean drape does not depend on one")
    template = apply_mean_drape(model.mean, jnp.asarray(design))
    return jnp.einsum(
        "vk,vkc->vc", jnp.asarray(garment.template_weights), template[garment.template_vertices], precision=EXACT
    )
