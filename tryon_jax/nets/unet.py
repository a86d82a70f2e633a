"""Graph U-Net: Chebyshev convolutions with pooling, unpooling and skip connections (sections 4.2 and 4.3)."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from tryon_jax.checks import check_choice, check_range
from tryon_jax.graph.build import GraphLevel
from tryon_jax.graph.operator import apply_operator
from tryon_jax.nets.cheb import ChebConv, cheb_conv, init_cheb_conv
from tryon_jax.types import pytree, static


def leaky_relu(x: Array) -> Array:
    """max(x, 0.1 x)."""
    return jnp.maximum(x, 0.1 * x)


ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "leaky_relu": leaky_relu,
    "elu": jax.nn.elu,
    "silu": jax.nn.silu,
    "tanh": jnp.tanh,
}
"""Activations by name, as configurations and parameter stores name them."""


def layer_norm(x: Array) -> Array:
    """Features of each node less their mean, over their deviation; without parameters."""
    centred = x - x.mean(axis=-1, keepdims=True)
    return centred * jax.lax.rsqrt((centred * centred).mean(axis=-1, keepdims=True) + 1e-5)


NORMALISATIONS: dict[str, Callable[[Array], Array]] = {"none": lambda x: x, "layer": layer_norm}
"""What happens between a convolution and its activation. Only per-node ones: padded nodes must not be seen."""


@dataclass(frozen=True)
class UNetConfig:
    """Size of a graph U-Net; hashable, part of the parameter pytree's structure."""

    widths: tuple[int, ...] = (32, 48, 64, 96)
    """Features at each level, finest first; the length is the number of levels, one more than there are poolings."""
    encoder_convs: int = 2
    """Convolutions per level on the way down."""
    decoder_convs: int = 1
    """Convolutions per level on the way up."""
    order: int = 2
    """Chebyshev order K: the filter reaches K − 1 edges far."""
    activation: str = "leaky_relu"
    normalisation: str = "none"

    def __post_init__(self) -> None:
        check_choice("activation", self.activation, ACTIVATIONS)
        check_choice("normalisation", self.normalisation, NORMALISATIONS)
        check_range("Chebyshev order", self.order, 1, 64)
        check_range("number of levels", len(self.widths), 1, 16)
        check_range("encoder_convs", self.encoder_convs, 1, 64)
        check_range("decoder_convs", self.decoder_convs, 1, 64)


@pytree
class UNet:
    """Parameters of a graph U-Net."""

    encoder: tuple[tuple[ChebConv, ...], ...]
    """Convolutions of each level, finest first."""
    decoder: tuple[tuple[ChebConv, ...], ...]
    """Convolutions of each level but the coarsest, finest first."""
    head: ChebConv
    """Last convolution, to the outputs, without activation."""
    config: UNetConfig = static(default=UNetConfig())


def init_unet(key: PRNGKeyArray, config: UNetConfig, inputs: int, outputs: int = 3) -> UNet:
    """Random parameters; the head starts small, so that an untrained network predicts next to nothing.

    Args:
        key: Random key.
        config: Widths and convolutions.
        inputs: Features of a node that come in.
        outputs: Features of a node that go out.
    """
    count = len(config.widths) * (config.encoder_convs + config.decoder_convs) + 1
    keys = iter(jax.random.split(key, count))

    def level(convs: int, width_in: int, width: int) -> tuple[ChebConv, ...]:
        sizes = [width_in] + [width] * convs
        return tuple(init_cheb_conv(next(keys), config.order, sizes[i], sizes[i + 1]) for i in range(convs))

    widths = config.widths
    before = (inputs, *widths)
    encoder = tuple(level(config.encoder_convs, before[i], widths[i]) for i in range(len(widths)))
    decoder = tuple(level(config.decoder_convs, widths[i] + widths[i + 1], widths[i]) for i in range(len(widths) - 1))
    head = init_cheb_conv(next(keys), config.order, widths[0], outputs, scale=0.1)
    return UNet(encoder, decoder, head, config)


def apply_unet(params: UNet, levels: tuple[GraphLevel, ...], features: Float[Array, "N B i"]) -> Float[Array, "N B o"]:
    """Outputs at each node for B samples of one garment; padded nodes hold arbitrary values and influence none.

    `levels` may hold more resolutions than the network uses. Map over garments with `jax.vmap`.

    Args:
        params: Weights.
        levels: Resolutions of the graph, the finest first; there may be more than the network uses.
        features: Of the finest nodes.
    """
    config = params.config
    depth = len(config.widths)
    if len(levels) < depth:
        raise ValueError(f"the network pools to {depth} levels, but the graph has only {len(levels)}")
    activate = ACTIVATIONS[config.activation]
    normalise = NORMALISATIONS[config.normalisation]
    skips = []
    for level, convs in zip(levels, params.encoder, strict=False):
        for conv in convs:
            features = activate(normalise(cheb_conv(conv, level.laplacian, features)))
        skips.append(features)
        if len(skips) < depth:
            assert level.down is not None
            features = apply_operator(level.down, features)
    for i in range(depth - 2, -1, -1):
        up = levels[i].up
        assert up is not None
        features = jnp.concatenate([apply_operator(up, features), skips[i]], axis=-1)
        for conv in params.decoder[i]:
            features = activate(normalise(cheb_conv(conv, levels[i].laplacian, features)))
    return cheb_conv(params.head, levels[0].laplacian, features)


def count_parameters(params: object) -> int:
    """Number of floating-point numbers in a parameter pytree."""
    return sum(leaf.size for leaf in jax.tree.leaves(params) if jnp.issubdtype(leaf.dtype, jnp.floating))
