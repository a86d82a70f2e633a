"""The few numbers of a fabric that its drape hangs on: what the networks see of it."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.state import GRAVITY
from tryon_jax.physics.stretch import FLOOR, stiffness

FABRIC_NUMBERS = ("bending length", "warp give", "weft give", "shear give")
"""What the entries of `fabric_numbers` are called."""
_STRAIN = 0.05
"""Green strain at which stiffness is read: about that of a hanging garment in knitted fabric."""


def fabric_numbers(fabric: Fabric) -> Float[Array, "4"]:
    """Logarithms of bending length and give of a fabric; differentiable with respect to its measured tables.

    Cloth that rests on a body under its own weight, with a given friction, is unchanged by a common factor of weight
    and stiffness. So only ratios count: the bending length (B / ρg)^(1/3), metres, as textile laboratories measure it
    (B the mean over directions and curvatures), and the strain ρg / k, 1/m, that each metre of hanging cloth adds.

    Args:
        fabric: The cloth.

    Returns:
        Natural logarithms, in the order of `FABRIC_NUMBERS`.
    """
    weight = jnp.asarray(fabric.density) * GRAVITY
    strains = jnp.array([[_STRAIN, 0.0, 0.0], [0.0, _STRAIN, 0.0], [0.0, 0.0, 2.0 * _STRAIN]], weight.dtype)
    # Entries are (warp, coupling, weft, shear): each is read where that strain is present.
    axial = jnp.diagonal(stiffness(strains, fabric)[:, jnp.array([0, 2, 3])])
    bending = jnp.asarray(fabric.bending).mean()
    return jnp.concatenate([jnp.log(bending / weight)[None] / 3.0, jnp.log(weight / jnp.maximum(axial, FLOOR))])


# One small program for all fabrics: op by op, JAX compiles each by itself.
_compiled = jax.jit(fabric_numbers)


def host_fabric_numbers(fabric: Fabric) -> Float[np.ndarray, "4"]:
    """`fabric_numbers` as a NumPy array, compiled once; host side.

    Args:
        fabric: The cloth.
    """
    return np.asarray(_compiled(fabric.unnamed))
