"""A trained graph U-Net with more features at each level that computes, at first, what it computed before.

Features that are added see the old ones through random weights, and the old ones see nothing of them: a network that
has learned all it can hold is trained further in a larger one (function-preserving growth, Chen et al. 2016).
"""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int, PRNGKeyArray

from tryon_jax.nets.cheb import ChebConv
from tryon_jax.nets.unet import UNet, init_unet


def widen_unet(key: PRNGKeyArray, net: UNet, widths: Sequence[int]) -> UNet:
    """The same function with `widths` features at each level.

    Args:
        key: for the weights of the features that are added.
        net: trained parameters.
        widths: features at each level, finest first, none fewer than before.

    Raises:
        ValueError: another number of levels, fewer features than before, or a normalisation over features, whose
            result would change with their number.
    """
    old, config = net.config.widths, replace(net.config, widths=tuple(widths))
    if len(widths) != len(old) or any(new < before for new, before in zip(widths, old, strict=True)):
        raise ValueError(f"widths = {tuple(widths)} must be {len(old)} numbers, none smaller than those of {old}")
    if config.normalisation != "none":
        raise ValueError(f"normalisation = {config.normalisation!r}: only networks without one can be widened")
    inputs, outputs = net.encoder[0][0].weight.shape[1], net.head.weight.shape[2]
    grown = init_unet(key, config, inputs, outputs)

    def level(convs: tuple[ChebConv, ...], into: tuple[ChebConv, ...], first: Int[np.ndarray, " i"], width: int):
        kept = [first] + [np.arange(width)] * (len(convs) - 1)
        return tuple(_embed(c, g, k) for c, g, k in zip(convs, into, kept, strict=True))

    encoder, decoder = [], []
    for i, convs in enumerate(net.encoder):
        first = np.arange(old[i - 1] if i else inputs)
        encoder.append(level(convs, grown.encoder[i], first, old[i]))
    for i, convs in enumerate(net.decoder):
        # What a decoder sees is the level below, then the skip connection: the latter has moved.
        first = np.concatenate([np.arange(old[i + 1]), config.widths[i + 1] + np.arange(old[i])])
        decoder.append(level(convs, grown.decoder[i], first, old[i]))
    return UNet(tuple(encoder), tuple(decoder), _embed(net.head, grown.head, np.arange(old[0])), config)


def _embed(conv: ChebConv, grown: ChebConv, kept: Int[np.ndarray, " i"]) -> ChebConv:
    """`conv` inside a larger one: its inputs at the rows `kept`, its outputs first."""
    outputs = conv.weight.shape[2]
    weight = jnp.asarray(grown.weight).at[:, :, :outputs].set(0.0).at[:, kept, :outputs].set(conv.weight)
    return ChebConv(weight, jnp.asarray(grown.bias).at[:outputs].set(conv.bias))
