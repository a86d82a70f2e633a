"""A dressed body in another pose: body and garment skinned by the same joints.

The garment is draped in T-pose and moved by linear blend skinning (Loper et al. 2015): no fold forms or vanishes. Good
for loose arms and poses near the T-pose; a bent knee under a tight skirt needs simulation.
"""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.body import pose_body
from tryon_jax.checks import check_file, check_finite
from tryon_jax.types import ArrayLike, Body


def pose_dressed(
    body: Body,
    body_vertices: Float[ArrayLike, "B 3"],
    vertices: Float[ArrayLike, "V 3"],
    weights: Float[ArrayLike, "V J"],
    pose: Float[ArrayLike, "J 3"],
) -> tuple[Float[Array, "B 3"], Float[Array, "V 3"]]:
    """Body and garment in `pose`, metres. Pure: jit, grad and `vmap` over poses.

    Args:
        body: its joints, weights and, where it has them, pose blend shapes (which the garment does not follow).
        body_vertices: the shaped body in T-pose, metres.
        vertices: the garment on it, metres.
        weights: skinning weights of the garment, e.g. from `garment_skinning`.
        pose: axis-angle vector of each joint relative to its parent, radians.

    Raises:
        ValueError: `pose` is not one vector for each joint.
    """
    body_points, points = jnp.asarray(body_vertices), jnp.asarray(vertices)
    count, extra = len(body_points), len(points)
    joints = jnp.asarray(body.J_regressor)
    both = replace(
        body,
        v_template=jnp.concatenate([body_points, points]),
        shapedirs=jnp.zeros((count + extra, 3, 1), body_points.dtype),
        J_regressor=jnp.concatenate([joints, jnp.zeros((len(joints), extra), joints.dtype)], axis=1),
        lbs_weights=jnp.concatenate([jnp.asarray(body.lbs_weights), jnp.asarray(weights, body_points.dtype)]),
        posedirs=None if body.posedirs is None else jnp.pad(jnp.asarray(body.posedirs), ((0, 0), (0, extra), (0, 0))),
    )
    posed, _ = pose_body(both, jnp.zeros(1, body_points.dtype), pose)
    return posed[:count], posed[count:]


def read_pose(path: str | Path, num_joints: int) -> Float[np.ndarray, "J 3"]:
    """A pose from an NPZ file with the array `pose`: [J, 3] or flat, axis-angle in radians.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no NPZ file of plain arrays, lacks `pose`, or its size is not that of `num_joints` joints.
    """
    file = check_file("pose file", path)
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            names = list(archive.files)
            pose = archive["pose"] if "pose" in names else None
    except Exception as error:
        raise ValueError(f"{str(file)!r} is not a readable .npz of plain arrays: {error}") from error
    if pose is None:
        raise ValueError(f"{str(file)!r} has no array 'pose' (it has {names[:12]})")
    if pose.size != 3 * num_joints:
        raise ValueError(
            f"pose in {str(file)!r} must be {num_joints} axis-angle vectors in radians, got an array of {pose.shape}"
        )
    return np.asarray(check_finite("pose", pose), np.float64).reshape(num_joints, 3)
