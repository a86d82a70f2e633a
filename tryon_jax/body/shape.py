"""Shape of a body: betas to vertices and joints (Loper et al. 2015, equations 8 and 10)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike as AnyArrayLike

from tryon_jax.checks import check_finite
from tryon_jax.types import EXACT, ArrayLike, Body

MAX_BETA = 5.0
"""Largest beta that is accepted, standard deviations: larger ones are taken for mistakes."""


def shape_body(body: Body, betas: Float[ArrayLike, " b"]) -> tuple[Float[Array, "V 3"], Float[Array, "J 3"]]:
    """Vertices and joints (metres, T-pose) of `body` with shape `betas` (standard deviations).

    Fewer betas than `body.num_betas` mean zeros for the rest. Pure: jit, grad and `vmap` over betas.

    Raises `ValueError` when `betas` is not one vector of at most `body.num_betas` numbers.
    """
    betas = jnp.asarray(betas)
    if betas.ndim != 1 or betas.shape[0] > body.num_betas:
        raise ValueError(
            f"betas must be one vector of 0 to {body.num_betas} numbers for body {body.name!r}, got shape "
            f"{betas.shape} (use jax.vmap for a batch)"
        )
    directions = jnp.asarray(body.shapedirs)[..., : betas.shape[0]]
    vertices = jnp.asarray(body.v_template) + jnp.einsum("vdb,b->vd", directions, betas, precision=EXACT)
    joints = jnp.matmul(jnp.asarray(body.J_regressor), vertices, precision=EXACT)
    return vertices, joints


def check_betas(body: Body, betas: AnyArrayLike) -> Float[Array, " b"]:
    """`betas` as a float vector fit for `shape_body`, for values that a user hands in (host side).

    Raises `ValueError` for a wrong length, NaN, infinity or a value beyond `MAX_BETA`, `TypeError` for things that are
    not numbers.
    """
    vector = check_finite("betas", betas)
    if vector.ndim != 1 or len(vector) > body.num_betas:
        raise ValueError(
            f"betas must be 0 to {body.num_betas} numbers for body {body.name!r}, got an array of shape {vector.shape}"
        )
    far = np.flatnonzero(np.abs(vector) > MAX_BETA)
    if len(far):
        k = far[0]
        raise ValueError(
            f"beta {k + 1} = {vector[k]:g} is outside its range {-MAX_BETA:g} to {MAX_BETA:g} standard deviations"
        )
    return jnp.asarray(vector, jnp.result_type(float))


def full_betas(body: Body, betas: Float[np.ndarray, " k"], num_betas: int) -> Float[np.ndarray, " b"]:
    """The first `num_betas` betas of a body, of which a user gave some (host side).

    Args:
        body: The body.
        betas: At most `num_betas` numbers, standard deviations; those left out are 0.
        num_betas: How many are taken: all of the body, or those that the networks know.

    Raises:
        ValueError: Too many betas, or values that `check_betas` refuses.
    """
    if len(betas) > num_betas:
        raise ValueError(f"betas has {len(betas)} numbers, but only the first {num_betas} are known")
    every = np.zeros(num_betas, np.float32)
    every[: len(betas)] = betas
    return np.asarray(check_betas(body, every), np.float32)
