"""Lowered arms under cloth: the collision surface goes with the skin, and a sleeve stays round its arm."""

import numpy as np
import pytest
from cloth_scenes import make_fabric

from tryon_jax.body import load_body, pose_body
from tryon_jax.body.stance import arms_pose
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.physics.cloth import build_cloth
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, relax
from tryon_jax.physics.proxy import skinning_weights
from tryon_jax.physics.stance import STEP, StanceObstacle, lower_arms
from tryon_jax.physics.state import SolverSettings

BODY = load_body("female")
BETAS = np.array([0.5, 0.5], np.float32)
FABRIC = make_fabric(warp=200.0, shear=60.0, bending=2e-5, density=0.2, thickness=0.005, friction=0.8)
SETTINGS, EQUILIBRIUM = SolverSettings(), Equilibrium(max_steps=60)
ROUND, LONG, RADIUS = 16, 6, 0.075


@pytest.fixture(scope="module")
def obstacle() -> StanceObstacle:
    return StanceObstacle(Obstacle(BODY), BETAS)


def sleeve() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A closed tube round the middle of the left upper arm: vertices, faces, pattern, faces in the pattern."""
    _, joints = pose_body(BODY, BETAS, np.zeros((24, 3), np.float32))
    shoulder, elbow = (np.asarray(joints)[BODY.joint_names.index(f"L_{name}")] for name in ("shoulder", "elbow"))
    step = 2 * np.pi * RADIUS / ROUND
    middle = 0.5 * (shoulder + elbow)
    angles = 2 * np.pi * np.arange(ROUND) / ROUND
    rings = [
        middle
        + np.column_stack([np.full(ROUND, (k - LONG / 2) * step), RADIUS * np.cos(angles), RADIUS * np.sin(angles)])
        for k in range(LONG + 1)
    ]
    i, k = (a.ravel() for a in np.meshgrid(np.arange(ROUND), np.arange(LONG), indexing="ij"))
    across = (i + 1) % ROUND

    def faces(columns: int, nxt: np.ndarray) -> np.ndarray:
        a, b, c, d = k * columns + i, k * columns + nxt, (k + 1) * columns + i, (k + 1) * columns + nxt
        return np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])

    u, v = np.meshgrid(np.arange(ROUND + 1) * step, np.arange(LONG + 1) * step)
    return np.concatenate(rings), faces(ROUND, across), np.stack([u.ravel(), v.ravel()], 1), faces(ROUND + 1, i + 1)


def test_the_surface_goes_with_the_skin(obstacle: StanceObstacle) -> None:
    collision = obstacle.collision
    skin = np.asarray(pose_body(BODY, BETAS, arms_pose(BODY, 30.0).astype(np.float32))[0])
    found = np.asarray(obstacle.surface(obstacle.at(30.0)).vertices)[: len(collision.keep)]
    feet = np.isin(collision.keep, np.concatenate(collision.feet))
    np.testing.assert_allclose(found[~feet], skin[collision.keep][~feet], atol=1e-5)


def test_mittens_go_with_the_hands(obstacle: StanceObstacle) -> None:
    weights = skinning_weights(obstacle.collision, np.asarray(BODY.lbs_weights))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-5)
    skin = np.asarray(pose_body(BODY, BETAS, arms_pose(BODY, 45.0).astype(np.float32))[0])
    found = np.asarray(obstacle.surface(obstacle.at(45.0)).vertices)[len(obstacle.collision.keep) :]
    for mitten, tube in zip(obstacle.collision.mittens, np.split(found, 2), strict=True):
        assert np.linalg.norm(tube.mean(axis=0) - skin[mitten.hand].mean(axis=0)) < 0.05


def test_points_that_go_down_and_up_are_where_they_were(obstacle: StanceObstacle) -> None:
    points = np.asarray(obstacle.surface(obstacle.at(0.0)).vertices, np.float64)
    weights = skinning_weights(obstacle.collision, np.asarray(BODY.lbs_weights))
    down = obstacle.carry(points, weights, 0.0, 40.0)
    assert np.linalg.norm(down - points, axis=1).max() > 0.3
    np.testing.assert_allclose(obstacle.carry(down, weights, 40.0, 0.0), points, atol=1e-5)


def test_a_sleeve_stays_round_its_arm(obstacle: StanceObstacle) -> None:
    vertices, faces, uv, faces_uv = sleeve()
    cloth = build_cloth(faces, uv, faces_uv, len(vertices), bucket=128)
    slip = np.zeros_like(vertices)
    start: Drape = relax(
        vertices, slip, np.array([0.0]), cloth, FABRIC, obstacle, SETTINGS, Equilibrium(max_steps=200), 200
    )
    assert start.converged(EQUILIBRIUM)
    weights = np.zeros((len(vertices), 24))
    weights[:, BODY.joint_names.index("L_shoulder")] = 1.0
    found = list(lower_arms(start, weights, 2 * STEP, cloth, FABRIC, obstacle, SETTINGS, EQUILIBRIUM))
    assert [stance.degrees for stance in found] == [STEP, 2 * STEP]
    last = found[-1].drape
    assert last.converged(EQUILIBRIUM)
    skin = np.asarray(pose_body(BODY, BETAS, arms_pose(BODY, 2 * STEP).astype(np.float32))[0], np.float64)
    distance = ClosedSurface(skin, np.asarray(BODY.faces)).closest(last.vertices.astype(np.float64)).distance
    assert distance.min() > 0.0
    assert distance.max() < 0.12, "it hangs on the arm: half its girth less that of the arm"
    assert not self_intersecting_faces(last.vertices, faces).any()
