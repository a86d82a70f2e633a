"""Arms lowered by one number: symmetric, bent a little, and only the arms."""

import numpy as np
import pytest

from tests.physics.round_body import make_ball
from tryon_jax.body import load_body, pose_body
from tryon_jax.body.pose import skinning_motion
from tryon_jax.body.stance import LOWEST, arms_pose

BODY = load_body("female")
BETAS = np.array([0.5, -0.3], np.float32)


def at(degrees: float) -> tuple[np.ndarray, np.ndarray]:
    vertices, joints = pose_body(BODY, BETAS, arms_pose(BODY, degrees).astype(np.float32))
    return np.asarray(vertices), np.asarray(joints)


def test_no_angle_is_the_tpose() -> None:
    assert not arms_pose(BODY, 0.0).any()


def test_upper_arms_hang_by_the_angle_on_both_sides() -> None:
    before, after = at(0.0)[1], at(40.0)[1]
    for side, sign in (("L", 1.0), ("R", -1.0)):
        shoulder, elbow, wrist = (BODY.joint_names.index(f"{side}_{name}") for name in ("shoulder", "elbow", "wrist"))
        was, now = before[elbow] - before[shoulder], after[elbow] - after[shoulder]
        turned = np.arctan2(now[1], sign * now[0]) - np.arctan2(was[1], sign * was[0])
        np.testing.assert_allclose(np.rad2deg(turned), -40.0, atol=0.01)
        assert after[wrist, 2] > after[elbow, 2] + 0.02, "the forearm bends forwards"


def test_nothing_below_the_arms_moves() -> None:
    before, after = at(0.0)[0], at(LOWEST)[0]
    low = before[:, 1] < 0.0
    np.testing.assert_allclose(after[low], before[low], atol=1e-5)


def test_skinning_of_any_points_is_that_of_the_body() -> None:
    pose = arms_pose(BODY, 30.0).astype(np.float32)
    linear, shift = skinning_motion(BODY, BETAS, pose, np.asarray(BODY.lbs_weights))
    moved = np.einsum("vab,vb->va", linear, at(0.0)[0]) + np.asarray(shift)
    np.testing.assert_allclose(moved, at(30.0)[0], atol=1e-5)


def test_what_cannot_be_lowered_is_refused() -> None:
    for degrees in (-1.0, LOWEST + 1):
        with pytest.raises(ValueError, match=r"arms = .* degrees below the horizontal"):
            arms_pose(BODY, degrees)
    with pytest.raises(ValueError, match="no joint 'L_shoulder'"):
        arms_pose(make_ball(1), 10.0)
