"""Sines and cosines of coordinates, so that networks can fit what varies quickly in space (Tancik et al. 2020)."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def fourier_features(values: Float[Array, "*batch c"], wavelengths: Sequence[float]) -> Float[Array, "*batch f"]:
    """sin(2π x / λ) and cos(2π x / λ) of every coordinate x and wavelength λ; f = 2 · c · len(wavelengths).

    Args:
        values: Coordinates, in the unit of the wavelengths.
        wavelengths: None of them zero; none at all gives no features.
    """
    if not wavelengths:
        return jnp.zeros((*values.shape[:-1], 0), values.dtype)
    frequencies = jnp.asarray(2 * np.pi / np.asarray(wavelengths), values.dtype)
    phases = jnp.concatenate([values * frequency for frequency in frequencies], axis=-1)
    return jnp.concatenate([jnp.sin(phases), jnp.cos(phases)], axis=-1)
