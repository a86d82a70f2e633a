"""How a body stands: arms from the horizontal of the T-pose down to the sides, by one number."""

import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_range
from tryon_jax.types import Body

LOWEST = 45.0
"""Degrees. Farther down, arms that are moved by skinning press cloth into the trunk, and it finds no rest."""
ELBOW_BEND = 0.25
"""Share of the arms' angle by which elbows bend forwards: a hanging arm is not straight."""
_SIDES = (("L", 1.0), ("R", -1.0))


def arms_pose(body: Body, degrees: float) -> Float[np.ndarray, "J 3"]:
    """The pose of a body whose arms hang `degrees` below the horizontal, elbows slightly bent.

    Args:
        body: With SMPL's joints.
        degrees: 0, the T-pose, to `LOWEST`.

    Returns:
        Axis-angle vector of each joint relative to its parent, radians, as `pose_body` takes it.

    Raises:
        ValueError: An angle out of range, or a body without shoulders and elbows of these names.
    """
    angle = np.deg2rad(check_range("arms", degrees, 0.0, LOWEST, "degrees below the horizontal"))
    return angle * arms_turns(body)


def arms_turns(body: Body) -> Float[np.ndarray, "J 3"]:
    """Axis-angle vectors of `arms_pose` for each radian that the arms come down; host side, no device value is read.

    Args:
        body: With SMPL's joints.

    Raises:
        ValueError: A body without shoulders and elbows of these names.
    """
    turns = np.zeros((len(body.parents), 3))
    for side, sign in _SIDES:
        for joint, turn in ((f"{side}_shoulder", (0.0, 0.0, -1.0)), (f"{side}_elbow", (0.0, -ELBOW_BEND, 0.0))):
            if joint not in body.joint_names:
                raise ValueError(f"body {body.name!r} has no joint {joint!r}: its arms cannot be lowered")
            turns[body.joint_names.index(joint)] = sign * np.array(turn)
    return turns
