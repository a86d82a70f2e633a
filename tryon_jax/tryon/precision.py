"""Networks in half precision: weights and features in bfloat16, positions and displacements in float32."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from tryon_jax.nets.unet import UNet
from tryon_jax.tryon.model import TryOnModel


def cast_net(net: UNet, dtype: Any) -> UNet:
    """A U-Net with its weights in another floating type; `apply_stage` then computes in it."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), net)


def with_precision(model: TryOnModel, dtype: Any = jnp.bfloat16) -> TryOnModel:
    """The model with the U-Nets in another floating type. `drape` still takes and gives float32.

    bfloat16 halves memory and traffic where the device has it; `python -m benchmarks compare` measures what it costs
    in millimetres.
    """

    def cast(stage: Any) -> Any:
        return dataclasses.replace(stage, net=cast_net(stage.net, dtype))

    fine = {fabric: cast(stage) for fabric, stage in model.fine.items()}
    return dataclasses.replace(model, smooth=cast(model.smooth), fine=fine)
