"""Polynomials of a body's shape, fitted to values on a few bodies that cover a range of betas."""

from itertools import combinations_with_replacement
from math import prod

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.types import EXACT, ArrayLike, pytree, static

_DEGREES = {1: 4, 2: 4}
"""Degree by the number of betas; `_DEGREE_OF_MORE` of more."""
_DEGREE_OF_MORE = 2
_RINGS = {0.5: 6, 1.0: 12}
"""Body shapes on an ellipse of this size, for two betas."""


@pytree
class ShapePolynomials:
    """S body shapes, and how values on these become polynomials of T terms; made by `shape_polynomials`."""

    betas: Float[ArrayLike, "*batch S b"]
    """Standard deviations; the first are the mean body's."""
    half_axes: Float[ArrayLike, "*batch b"]
    """Of the ellipse that the shapes cover, standard deviations."""
    fit: Float[ArrayLike, "*batch T S"]
    """From values on the bodies to the coefficients of their least squares polynomial."""
    powers: tuple[tuple[int, ...], ...] = static(default=())
    """Which betas are multiplied in each term."""


def shape_polynomials(half_axes: tuple[float, ...]) -> ShapePolynomials:
    """Polynomials over an ellipse of betas: 15 terms from 19 bodies for two betas (host side).

    Args:
        half_axes: Of the ellipse, standard deviations, one for each beta.
    """
    axes = np.asarray(half_axes, np.float64)
    count = len(axes)
    degree = _DEGREES.get(count, _DEGREE_OF_MORE)
    powers = tuple(p for d in range(degree + 1) for p in combinations_with_replacement(range(count), d))
    unit = _shapes_of_unit_ball(count, len(powers))
    terms = np.stack([unit[:, list(power)].prod(axis=1) for power in powers], axis=1)
    betas, axes, fit = (array.astype(np.float32) for array in (unit * axes[None], axes, np.linalg.pinv(terms)))
    return ShapePolynomials(betas, axes, fit, powers)


def fit_polynomials(polynomials: ShapePolynomials, values: Float[Array, " S *rest"]) -> Float[Array, " *rest T"]:
    """Coefficients of the polynomials of values on the bodies of `polynomials.betas`.

    Args:
        polynomials: From `shape_polynomials`.
        values: On each of the bodies.
    """
    fit = jnp.asarray(polynomials.fit, values.dtype)
    return jnp.einsum("ts,s...->...t", fit, values, precision=EXACT)


def polynomial_terms(polynomials: ShapePolynomials, betas: Float[Array, "B b"]) -> Float[Array, "B T"]:
    """The terms for bodies of shape `betas`; beyond the ellipse, those of its border.

    Args:
        polynomials: From `shape_polynomials`.
        betas: Standard deviations.
    """
    unit = betas / jnp.asarray(polynomials.half_axes)[None]
    # A polynomial says nothing beyond what it was fitted to.
    unit = unit / jnp.maximum(jnp.sqrt((unit * unit).sum(-1, keepdims=True) + 1e-12), 1.0)
    # A constant that lies on the devices that the betas lie on.
    one = 0.0 * unit[:, 0] + 1.0
    return jnp.stack([prod((unit[:, k] for k in power), start=one) for power in polynomials.powers], axis=1)


def _shapes_of_unit_ball(dimensions: int, terms: int) -> Float[np.ndarray, "S b"]:
    """The centre, and points half way to the border and on it."""
    if dimensions == 1:
        half = np.arange(1, terms + 1) / terms
        return np.concatenate([[0.0], half, -half])[:, None]
    if dimensions == 2:
        angles = {size: np.arange(n) * 2 * np.pi / n for size, n in _RINGS.items()}
        rings = [size * np.stack([np.cos(a), np.sin(a)], axis=1) for size, a in angles.items()]
        return np.concatenate([np.zeros((1, 2)), *rings])
    directions = np.random.default_rng(0).normal(size=(2 * terms, dimensions))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[::2] *= 0.5
    return np.concatenate([np.zeros((1, dimensions)), directions])
