"""Drapes by the simulator on a ball: a loose tube comes to rest, a tight one is told from a torn one."""

import numpy as np
import pytest

from tests.physics.round_body import RADIUS, make_ball
from tryon_jax.physics.dressing import Equilibrium
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.wear.simulate import NotSettled, Pattern, Simulator

FABRIC = load_fabric("gray-interlock")


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(make_ball(3), equilibrium=Equilibrium(tolerance=0.02))


def cap(radius: float) -> tuple[np.ndarray, Pattern]:
    """A round sheet that lies over the upper half of the ball."""
    rings, spokes = 8, 24
    turn = np.linspace(0, 2 * np.pi, spokes + 1)[:-1]
    flat = [np.zeros((1, 2))]
    flat += [0.18 * k / rings * np.stack([np.cos(turn), np.sin(turn)], axis=1) for k in range(1, rings + 1)]
    uv = np.concatenate(flat)
    faces = [[0, 1 + k, 1 + (k + 1) % spokes] for k in range(spokes)]
    for ring in range(rings - 1):
        a = 1 + ring * spokes
        for k in range(spokes):
            b = (k + 1) % spokes
            faces += [[a + k, a + spokes + k, a + spokes + b], [a + k, a + spokes + b, a + b]]
    faces = np.array(faces)
    length = np.linalg.norm(uv, axis=1)
    angle = length / radius
    outward = np.divide(uv, length[:, None], out=np.zeros_like(uv), where=length[:, None] > 0)
    points = radius * np.stack([np.sin(angle) * outward[:, 0], np.cos(angle), -np.sin(angle) * outward[:, 1]], axis=1)
    return points, Pattern(faces, uv, faces)


def test_a_sheet_settles_on_the_ball_and_stays_there(simulator: Simulator) -> None:
    points, pattern = cap(RADIUS + 0.01)
    seen = []
    result = simulator.settle(points, pattern, FABRIC, lambda steps, residual, _: seen.append((steps, residual)))
    assert result.at_rest or result.residual < 5 * result.tolerance
    assert np.linalg.norm(result.vertices, axis=1).min() > RADIUS - 1e-3
    assert seen[-1][0] == result.steps
    assert "residual" in result.words()
    again = simulator.refine(result.vertices, pattern, FABRIC, np.zeros(1), steps=5)
    assert again.steps <= 5
    assert again.moved.max() < 0.02


def test_what_falls_off_does_not_settle(simulator: Simulator) -> None:
    points, pattern = cap(RADIUS + 0.01)
    with pytest.raises(NotSettled, match=r"does not come to rest on the body|tears this garment"):
        simulator.settle(points + [0.6, 0.0, 0.0], pattern, FABRIC)


def test_bad_steps_are_refused(simulator: Simulator) -> None:
    points, pattern = cap(RADIUS + 0.01)
    with pytest.raises(ValueError, match=r"refine = 0 steps is outside its range"):
        simulator.refine(points, pattern, FABRIC, np.zeros(1), steps=0)
