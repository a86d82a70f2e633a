"""Pose of a body: pose blend shapes and linear blend skinning (Loper et al. 2015, equations 2 to 4 and 9)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.body.shape import shape_body
from tryon_jax.types import EXACT, ArrayLike, Body


def rotation_matrix(axis_angle: Float[ArrayLike, "3"]) -> Float[Array, "3 3"]:
    """Rotation by |axis_angle| radians about axis_angle (Rodrigues), with finite gradients at zero."""
    axis_angle = jnp.asarray(axis_angle)
    squared = jnp.sum(axis_angle**2)
    # The limits of sin(a)/a and (1 - cos(a))/a² at zero, by series: both are even, so they take the squared angle and
    # the square root is kept away from zero, where its gradient is infinite.
    small = squared < 1e-8
    safe = jnp.where(small, 1.0, squared)
    angle = jnp.sqrt(safe)
    first = jnp.where(small, 1 - squared / 6, jnp.sin(angle) / angle)
    second = jnp.where(small, 0.5 - squared / 24, 2 * jnp.sin(angle / 2) ** 2 / safe)
    x, y, z = axis_angle
    zero = jnp.zeros_like(x)
    cross = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    return jnp.eye(3, dtype=axis_angle.dtype) + first * cross + second * jnp.matmul(cross, cross, precision=EXACT)


def _chain(
    local: Float[Array, "J 3 3"], joints: Float[Array, "J 3"], parents: tuple[int, ...]
) -> tuple[Float[Array, "J 3 3"], Float[Array, "J 3"]]:
    """World rotation and position of each joint from rotations relative to the parents.

    Pointer doubling: every pass joins each chain with its ancestor's and doubles the reach, so the arms of SMPL take
    four batched products instead of a chain of nine.
    """
    count = len(parents)
    # One extra joint that never moves stands above the root.
    ancestor = np.array([parent if parent >= 0 else count for parent in parents] + [count])
    still = jnp.zeros((1, 3), joints.dtype)
    origin = jnp.concatenate([joints, still])
    turns = jnp.concatenate([local, jnp.eye(3, dtype=local.dtype)[None]])
    steps = origin - jnp.where((ancestor < count)[:, None], origin[ancestor], 0)
    while (ancestor < count).any():
        steps = jnp.einsum("jab,jb->ja", turns[ancestor], steps, precision=EXACT) + steps[ancestor]
        turns = jnp.matmul(turns[ancestor], turns, precision=EXACT)
        ancestor = ancestor[ancestor]
    return turns[:count], steps[:count]


def pose_body(
    body: Body, betas: Float[ArrayLike, " b"], pose: Float[ArrayLike, "J 3"]
) -> tuple[Float[Array, "V 3"], Float[Array, "J 3"]]:
    """Vertices and joints (metres) of `body` with shape `betas` in `pose`.

    `pose` holds one axis-angle vector in radians for each joint, relative to its parent; the first turns the whole body
    about its pelvis. All zeros is the T-pose of `shape_body`. Pose blend shapes are applied where the body has them
    (files of SMPL; the embedded bodies have none). Pure: jit, grad and `vmap`.

    Raises `ValueError` for betas of a wrong length or a pose that is not [J, 3].

    Args:
        body: The body.
        betas: Its shape, standard deviations; those left out are 0.
        pose: Axis-angle vector of each joint relative to its parent, radians.

    Raises:
        ValueError: betas of a wrong length, or a pose that is not [J, 3].
    """
    pose = jnp.asarray(pose)
    count = len(body.parents)
    if pose.shape != (count, 3):
        raise ValueError(
            f"pose must be [{count}, 3] axis-angle vectors in radians for body {body.name!r}, got shape {pose.shape}"
        )
    vertices, joints = shape_body(body, betas)
    local = jax.vmap(rotation_matrix)(pose)
    if body.posedirs is not None:
        bend = (local[1:] - jnp.eye(3, dtype=local.dtype)[None]).reshape(-1)
        vertices = vertices + jnp.einsum("p,pvd->vd", bend, jnp.asarray(body.posedirs), precision=EXACT)

    turned, posed = _chain(local, joints, body.parents)
    linear, shift = _blend(jnp.asarray(body.lbs_weights), turned, joints, posed)
    return jnp.einsum("vab,vb->va", linear, vertices, precision=EXACT) + shift, posed


def skinning_motion(
    body: Body, betas: Float[ArrayLike, " b"], pose: Float[ArrayLike, "J 3"], weights: Float[ArrayLike, "N J"]
) -> tuple[Float[Array, "N 3 3"], Float[Array, "N 3"]]:
    """Linear part and shift (metres) by which linear blend skinning moves points from the T-pose to `pose`.

    Args:
        body: The body.
        betas: Its shape, standard deviations.
        pose: As in `pose_body`.
        weights: Skinning weights of the points; rows sum to 1.
    """
    _, joints = shape_body(body, betas)
    turned, posed = _chain(jax.vmap(rotation_matrix)(jnp.asarray(pose)), joints, body.parents)
    return _blend(jnp.asarray(weights), turned, joints, posed)


def _blend(
    weights: Float[Array, "N J"],
    turned: Float[Array, "J 3 3"],
    joints: Float[Array, "J 3"],
    posed: Float[Array, "J 3"],
) -> tuple[Float[Array, "N 3 3"], Float[Array, "N 3"]]:
    shifts = posed - jnp.einsum("jab,jb->ja", turned, joints, precision=EXACT)
    linear = jnp.einsum("nj,jab->nab", weights, turned, precision=EXACT)
    return linear, jnp.matmul(weights, shifts, precision=EXACT)
