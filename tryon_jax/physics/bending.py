"""Bending as hinges between faces, with a stiffness that depends on grain direction and curvature (Wang et al. 2011).

The stiffness is read at |θ|: cloth folds alike to either side. (The reference implementation extrapolates its table
without a cap on one side, which makes a roll cost up to 2.9 times more there; on the other side both agree.)
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.fabrics import Fabric

CURVATURE_STEP = 5.0
"""1/m between the columns of the bending table."""


def dihedral_angles(x: Float[Array, "V 3"], cloth: Cloth) -> tuple[Float[Array, " H"], Float[Array, "H 4 3"]]:
    """Signed dihedral angle of each hinge, radians (0 = flat), and its gradient at the four vertices, 1/m."""
    # Hinges come last, along vector registers.
    p = x.T.at[:, jnp.asarray(cloth.hinges).T].get(mode="promise_in_bounds")
    edge, first, second = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], p[:, 3] - p[:, 0]
    n0, n1 = jnp.cross(edge, first, axis=0), jnp.cross(second, edge, axis=0)
    # Underflow guards far below the squared area of any real face (1e-8 m⁴).
    s0, s1 = (n0 * n0).sum(0) + 1e-16, (n1 * n1).sum(0) + 1e-16
    squared = (edge * edge).sum(0) + 1e-16
    length = jnp.sqrt(squared)
    theta = jnp.arctan2((jnp.cross(n0, n1, axis=0) * edge).sum(0) / length, (n0 * n1).sum(0))
    at_c = -(length / s0)[None] * n0
    at_d = -(length / s1)[None] * n1
    weight_c = ((first * edge).sum(0) / squared)[None]
    weight_d = ((second * edge).sum(0) / squared)[None]
    at_a = -(1 - weight_c) * at_c - (1 - weight_d) * at_d
    at_b = -weight_c * at_c - weight_d * at_d
    return theta, jnp.stack([at_a, at_b, at_c, at_d]).transpose(2, 0, 1)


def hinge_stiffness(theta: Float[Array, " H"], cloth: Cloth, fabric: Fabric) -> Float[Array, " H"]:
    """k_e, N·m: bilinear in grain angle and curvature, the softer of the hinge's two sides.

    Args:
        theta: Angle at each hinge, radians.
        cloth: Rest state.
        fabric: Material.
    """
    # The cell is clamped, not the value in it: at the end of the table the last entry counts whole.
    columns, rows = fabric.bending.shape[1] - 1, fabric.bending.shape[0] - 1
    curvature = jnp.clip(jnp.abs(theta) * cloth.hinge_curvature / CURVATURE_STEP, 0.0, columns)
    column = jnp.minimum(curvature.astype(jnp.int32), columns - 1)
    grain = jnp.clip(cloth.hinge_grain * (4 / jnp.pi), 0.0, rows)
    row = jnp.minimum(grain.astype(jnp.int32), rows - 1)
    c, r = (curvature - column)[:, None], grain - row
    table = jnp.asarray(fabric.bending, theta.dtype)
    column = column[:, None]
    value = (1 - r) * ((1 - c) * table[row, column] + c * table[row, column + 1])
    value = value + r * ((1 - c) * table[row + 1, column] + c * table[row + 1, column + 1])
    return value.min(axis=1)


def bending_energy(x: Float[Array, "V 3"], cloth: Cloth, fabric: Fabric) -> Float[Array, ""]:
    """k_e l² θ² / (8 (A0 + A1)) over all hinges, joules, flat at rest; the stiffness is a constant to derivatives.

    Args:
        x: Vertices, metres.
        cloth: Rest state.
        fabric: Material.
    """
    theta, _ = dihedral_angles(x, cloth)
    k = jax.lax.stop_gradient(hinge_stiffness(theta, cloth, fabric))
    return 0.5 * (k * cloth.hinge_shape * theta * theta).sum()


def bending_force(x: Float[Array, "V 3"], cloth: Cloth, fabric: Fabric) -> Float[Array, "V 3"]:
    """Force on each vertex, newtons.

    Args:
        x: Vertices, metres.
        cloth: Rest state.
        fabric: Material.
    """
    theta, gradient = dihedral_angles(x, cloth)
    moment = hinge_stiffness(theta, cloth, fabric) * cloth.hinge_shape * theta
    return jnp.zeros_like(x).at[cloth.hinges].add(-moment[:, None, None] * gradient)


def hinge_roots(stiffnesses: Float[Array, " H"], gradient: Float[Array, "H 4 3"]) -> Float[Array, "3 4 H"]:
    """Vectors at the corners of each hinge [xyz, corner, hinge] whose outer products are its tangent blocks.

    They make the Gauss-Newton matrix. Of it, the block between the two opposite corners (2 and 3) is left out, since
    they share no edge; its product is bounded by doubling their own blocks (2ab ≤ a² + b²). That is still positive
    semi-definite and above Gauss-Newton; the steps to equilibrium stay the same in number, and the system matrix needs
    half the blocks.

    Args:
        stiffnesses: k_e · shape, N·m.
        gradient: Of the angle, from `dihedral_angles`.
    """
    return jnp.sqrt(stiffnesses)[None, None] * gradient.transpose(2, 1, 0)
