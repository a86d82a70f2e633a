"""The fully connected regressor of the mean drape, R_mean (section 4.1)."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from tryon_jax.types import EXACT, ArrayLike, pytree


@pytree
class MLP:
    """Weights [inputs, outputs] and biases of each layer."""

    weights: tuple[Float[ArrayLike, "_ _"], ...]
    biases: tuple[Float[ArrayLike, " _"], ...]


def init_mlp(key: PRNGKeyArray, sizes: Sequence[int]) -> MLP:
    """Glorot initialisation of layers sizes[0] → sizes[1] → …; zero biases."""
    keys = jax.random.split(key, len(sizes) - 1)
    weights = tuple(
        jax.random.normal(k, (i, o)) * (2.0 / (i + o)) ** 0.5
        for k, i, o in zip(keys, sizes[:-1], sizes[1:], strict=True)
    )
    return MLP(weights, tuple(jnp.zeros(o) for o in sizes[1:]))


def apply_mlp(params: MLP, inputs: Float[Array, "*batch i"]) -> Float[Array, "*batch o"]:
    """tanh between the layers, none after the last."""
    hidden = inputs
    for i, (weight, bias) in enumerate(zip(params.weights, params.biases, strict=True)):
        bias = jnp.asarray(bias)
        hidden = jnp.matmul(hidden, weight, precision=EXACT) + bias.reshape((1,) * (hidden.ndim - 1) + bias.shape)
        if i + 1 < len(params.weights):
            hidden = jnp.tanh(hidden)
    return hidden


@pytree
class MeanDrape:
    """R_mean with its normalisation: design parameters in metres to template vertices in metres."""

    mlp: MLP
    """P → hidden → 3 T."""
    design_center: Float[ArrayLike, " P"]
    design_scale: Float[ArrayLike, " P"]
    """The network sees (design − center) / scale."""
    template_center: Float[ArrayLike, "T 3"]
    template_scale: Float[ArrayLike, ""]
    """Template vertices are center + scale · output, metres."""


def init_mean_drape(
    key: PRNGKeyArray,
    design_center: Float[ArrayLike, " P"],
    design_scale: Float[ArrayLike, " P"],
    template_center: Float[ArrayLike, "T 3"],
    template_scale: float = 0.1,
    hidden: int = 10,
) -> MeanDrape:
    """Random R_mean of the paper's size: P → 10 → 3 · 403.

    Args:
        key: Random key.
        design_center: Design that the network sees as zero, metres.
        design_scale: Half range of each parameter, metres.
        template_center: Template positions that an output of zero means, metres.
        template_scale: Metres that an output of one means.
        hidden: Hidden units.
    """
    outputs = int(jnp.size(template_center))
    mlp = init_mlp(key, (len(design_center), hidden, outputs))
    return MeanDrape(
        mlp,
        jnp.asarray(design_center),
        jnp.asarray(design_scale),
        jnp.asarray(template_center),
        jnp.asarray(template_scale),
    )


def apply_mean_drape(params: MeanDrape, design: Float[Array, " P"]) -> Float[Array, "T 3"]:
    """T̄ = R_mean(p), metres."""
    normalised = (design - params.design_center) / params.design_scale
    output = apply_mlp(params.mlp, normalised).reshape(params.template_center.shape)
    return jnp.asarray(params.template_center) + params.template_scale * output
