"""What the solver is told, and what its steps change."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tryon_jax.physics.body_contact import ContactLaw
from tryon_jax.types import ArrayLike, Scalar, pytree

GRAVITY = 9.81
"""m/s², along −y."""


@pytree
class SolverSettings:
    """Parameters of the solver; changing them compiles nothing."""

    time_step: Scalar = 1 / 30
    """Seconds."""
    retention: Scalar = 0.9
    """Share of the velocity that a step keeps: 1 is dynamics, 0 quasi-static."""
    gravity: Scalar = GRAVITY
    """m/s²."""
    max_move: Scalar = 8e-3
    """Metres that a vertex may move in one step."""
    contact_margin: Scalar = 5e-4
    """Metres deeper at which the contact stiffness is read."""
    linear_tolerance: Scalar = 0.15
    """Relative residual of the linear solve."""
    linear_iterations: int | Int[ArrayLike, ""] = 300
    law: ContactLaw = ContactLaw()
    coarse: Scalar = 1.0
    """Share of the coarse correction in the preconditioner; 0 leaves the diagonal blocks alone."""


@pytree
class ClothState:
    """Everything that a step changes; store all of it to continue a drape (friction remembers its slip)."""

    x: Float[Array, "V 3"]
    """Positions, metres, to the precision of their type."""
    remainder: Float[Array, "V 3"]
    """What single precision cuts off, metres: the cloth is at `x + remainder`. Without it, single precision moves the
    corners of stiff cloth by forces that are larger than the tolerance, and no step brings it to rest."""
    velocity: Float[Array, "V 3"]
    slip: Float[Array, "V 3"]
    """Elastic slip of friction, metres."""
    face: Int[Array, " S"]
    """Closest body face of each contact sample."""


def resting(x: Float[Array, "V 3"], face: Int[Array, " S"]) -> ClothState:
    """A state at rest at `x` (metres), its contact samples nearest to `face`."""
    zero = jnp.zeros_like(x)
    return ClothState(x, zero, zero, zero, face)
