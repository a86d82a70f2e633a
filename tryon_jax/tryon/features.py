"""What the networks see at each node of a garment (sections 4.2 and 4.3 of the paper, and what goes beyond it)."""

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.garment import build_template, load_design_space
from tryon_jax.garment.pattern_place import pattern_places
from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.fourier import fourier_features
from tryon_jax.tryon.garment import Garment
from tryon_jax.tryon.model import config_space
from tryon_jax.types import EXACT


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
    parts += _beta_features(config, betas if config.fine_betas else None)
    if config.fine_detail:
        parts.append(detail[:, None, :] / config.detail_scale)
    return _side_by_side(parts)


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
    if config.pattern_features:
        parts.append(_pattern_features(config, garment, points.dtype)[:, None, :])
    return parts


def _pattern_features(config: TryOnConfig, garment: Garment, dtype: jnp.dtype) -> Float[Array, "N f"]:
    """Place and side on the flat pattern of the mean design, and the waves of the place; zeros without a design.

    It is the mean design's for all: how far a design differs from it, the design says.
    """
    if garment.template_vertices is None or garment.template_weights is None:
        return jnp.zeros((garment.graph.num_nodes, 3 + 4 * len(config.wavelengths)), dtype)
    weights = jnp.asarray(garment.template_weights, dtype)
    table = jnp.asarray(_template_places(config.layout, config.template_vertices), dtype)
    places = jnp.einsum("nk,nkc->nc", weights, table[garment.template_vertices], precision=EXACT)
    waves = fourier_features(places[:, :2], config.wavelengths)
    features = jnp.concatenate([places[:, :2] / config.position_scale, places[:, 2:], waves], axis=1)
    # Without a place there are no waves of it either.
    return jnp.where(weights.any(axis=1, keepdims=True), features, 0.0)


@functools.cache
def _template_places(layout: str, vertices: int) -> Float[np.ndarray, "T 3"]:
    """Host side: where the template's vertices lie on the mean design's pattern."""
    space = load_design_space(layout)
    return pattern_places(build_template(space, space.mean_design, vertices))


def _beta_features(config: TryOnConfig, betas: Float[Array, "B b"] | None) -> list[Array]:
    return [] if betas is None else [betas[None] / config.beta_scale]


def _side_by_side(parts: list[Array]) -> Float[Array, "N B i"]:
    shape = jnp.broadcast_shapes(*[part.shape[:2] for part in parts])
    return jnp.concatenate([jnp.broadcast_to(part, (*shape, part.shape[-1])) for part in parts], axis=-1)
