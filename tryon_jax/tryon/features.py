"""What the networks see at each node of a garment (sections 4.2 and 4.3 of the paper, and what goes beyond it)."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.fourier import fourier_features
from tryon_jax.tryon.garment import Garment
from tryon_jax.tryon.model import config_space


def smooth_features(
    config: TryOnConfig, garment: Garment, betas: Float[Array, "B b"] | None = None
) -> Float[Array, "N B i"]:
    """Node features of R_smooth, scaled: M̄, skinning weights, waves of M̄, design, and the betas where they are given.

    Args:
        config: Which features there are, and their scales.
        garment: The garment, with M̄ and its design.
        betas: Shapes of B bodies; None (then B = 1) for features of the garment alone.
    """
    parts = _garment_features(config, garment, jnp.asarray(garment.graph.vertices)[:, None, :])
    return _side_by_side([*parts, *_beta_features(config, betas)])


def fine_features(
    config: TryOnConfig,
    garment: Garment,
    smooth_vertices: Float[Array, "N B 3"],
    detail: Float[Array, "N 3"],
    betas: Float[Array, "B b"] | None = None,
) -> Float[Array, "N B i"]:
    """Node features of R_fine: those of R_smooth at M_smooth in place of M̄, and, where configured, M̄'s detail.

    Args:
        config: Which features there are, and their scales.
        garment: The garment.
        smooth_vertices: M_smooth for B bodies, metres; M̄ (B = 1) for features of the garment alone.
        detail: M̄ − smooth(M̄), metres.
        betas: As in `smooth_features`.
    """
    parts = _garment_features(config, garment, smooth_vertices)
    if config.fine_detail:
        parts.append(detail[:, None, :] / config.detail_scale)
    return _side_by_side([*parts, *_beta_features(config, betas if config.fine_betas else None)])


def scaled_design(config: TryOnConfig, garment: Garment) -> Float[Array, " P"]:
    """The garment's design over the extent of the space, in [−1, 1]; zeros for a mesh without a design."""
    if garment.design is None:
        return jnp.zeros(config.num_parameters)
    space = config_space(config)
    design = jnp.asarray(garment.design)
    half = 0.5 * (space.maximum - space.minimum)
    return (design - space.middle.astype(design.dtype)) / half.astype(design.dtype)


def _garment_features(config: TryOnConfig, garment: Garment, points: Float[Array, "N B 3"]) -> list[Array]:
    weights = jnp.asarray(garment.graph.skinning_weights, points.dtype)[:, None, :]
    parts = [points / config.position_scale, weights / config.weight_scale]
    if config.wavelengths:
        parts.append(fourier_features(points, config.wavelengths))
    if config.design_features:
        parts.append(scaled_design(config, garment).astype(points.dtype)[None, None, :])
    return parts


def _beta_features(config: TryOnConfig, betas: Float[Array, "B b"] | None) -> list[Array]:
    return [] if betas is None else [betas[None] / config.beta_scale]


def _side_by_side(parts: list[Array]) -> Float[Array, "N B i"]:
    shape = jnp.broadcast_shapes(*[part.shape[:2] for part in parts])
    return jnp.concatenate([jnp.broadcast_to(part, (*shape, part.shape[-1])) for part in parts], axis=-1)
