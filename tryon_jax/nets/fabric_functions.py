"""Functions of a fabric's numbers that weight displacement fields: known at the trained fabrics, smooth between them.

A Gaussian process with an unknown constant mean (ordinary kriging; Rasmussen and Williams 2006, section 2.7) carries
the values of a handful of trained fabrics to all others. Its kernel has a smooth part and a linear one, and a share of
noise keeps it from following single fabrics. Far from all trained ones it goes back to their mean along the smooth
part and goes on along the linear one.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.types import EXACT, ArrayLike, pytree

_LENGTH = 2.0
"""Over which the smooth part changes, in standard deviations of the trained fabrics' numbers."""
_LINEAR = 0.3
_NOISE = 0.1


@pytree
class FabricFunctions:
    """J functions of F numbers of a fabric, from their values at T fabrics."""

    known: Float[ArrayLike, "T F"]
    """Numbers of the trained fabrics."""
    center: Float[ArrayLike, " F"]
    scale: Float[ArrayLike, " F"]
    """The kernel sees (numbers − center) / scale."""
    kernel_weights: Float[ArrayLike, "T+1 J"]
    """Of the kernel between a fabric and each trained one; the last row is the constant."""


def fit_fabric_functions(numbers: Float[np.ndarray, "T F"], values: Float[np.ndarray, "T J"]) -> FabricFunctions:
    """The functions that have these values at these fabrics, up to the share of noise; host side.

    Args:
        numbers: Of each trained fabric.
        values: Of each function there.
    """
    center, scale = numbers.mean(axis=0), np.maximum(numbers.std(axis=0), 1e-6)
    scaled = (numbers - center) / scale
    covariance = np.asarray(_kernel(jnp.asarray(scaled), jnp.asarray(scaled)), np.float64)
    count = len(numbers)
    system = np.ones((count + 1, count + 1))
    system[:count, :count] = covariance + _NOISE * np.eye(count)
    system[count, count] = 0.0
    right = np.concatenate([values, np.zeros((1, values.shape[1]))])
    weights = np.linalg.solve(system, right)
    return FabricFunctions(*(np.asarray(a, np.float32) for a in (numbers, center, scale, weights)))


def apply_fabric_functions(functions: FabricFunctions, numbers: Float[Array, " F"]) -> Float[Array, " J"]:
    """Values of the functions for a fabric.

    Args:
        functions: From `fit_fabric_functions`.
        numbers: Of the fabric.
    """
    center, scale = jnp.asarray(functions.center), jnp.asarray(functions.scale)
    scaled = (numbers - center) / scale
    known = (jnp.asarray(functions.known) - center[None]) / scale[None]
    weights = jnp.asarray(functions.kernel_weights)
    return jnp.matmul(_kernel(scaled[None], known)[0], weights[:-1], precision=EXACT) + weights[-1]


def field_pairs(fields: int, functions: int) -> tuple[tuple[int, int], ...]:
    """Which body coefficient k and fabric function j each displacement field is weighted by: (k+1)(j+1) ≤ `fields`.

    A hyperbolic cross: both are sorted by size, and products of two small ones are left out.

    Args:
        fields: Body coefficients.
        functions: Fabric functions.
    """
    return tuple((k, j) for j in range(functions) for k in range(fields) if (k + 1) * (j + 1) <= fields)


def mix_fields(
    fields: Float[Array, "N 3 M"], values: Float[Array, " J"], pairs: tuple[tuple[int, int], ...], count: int
) -> Float[Array, "N 3 K"]:
    """The fields of one fabric: those that share a body coefficient, weighted by their fabric functions.

    Args:
        fields: One for each pair.
        values: Of the fabric functions.
        pairs: From `field_pairs`.
        count: Body coefficients K.
    """
    k, j = np.array(pairs).T
    mix = jnp.zeros((len(pairs), count), fields.dtype).at[np.arange(len(pairs)), k].set(values[j].astype(fields.dtype))
    return jnp.matmul(fields, mix[None], precision=EXACT)


def _kernel(a: Float[Array, "A F"], b: Float[Array, "B F"]) -> Float[Array, "A B"]:
    squares = ((a[:, None] - b[None]) ** 2).sum(axis=-1)
    return jnp.exp(-0.5 * squares / _LENGTH**2) + _LINEAR * jnp.matmul(a, b.T, precision=EXACT)
