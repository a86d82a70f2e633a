"""A body that is a ball of 20 cm with one beta for its size: what cloth does on it is known."""

import numpy as np
import trimesh

from tryon_jax.types import Body

RADIUS = 0.2
GROWTH = 0.01
"""Metres of radius for one unit of beta."""


def make_ball(subdivisions: int = 4) -> Body:
    """The ball, centred at the origin, with SMPL's fields and one joint."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    directions = np.asarray(ball.vertices, np.float32)
    count = len(directions)
    return Body(
        v_template=RADIUS * directions,
        shapedirs=GROWTH * directions[:, :, None],
        J_regressor=np.full((1, count), 1 / count, np.float32),
        lbs_weights=np.ones((count, 1), np.float32),
        faces=np.asarray(ball.faces, np.int32),
        parents=(-1,),
        joint_names=("pelvis",),
        name="ball",
    )
