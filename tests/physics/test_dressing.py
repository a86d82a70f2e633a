"""Dressing and sweeping: a cloth thrown over a ball that grows."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import horizontal, make_cloth, make_fabric, sheet
from round_body import GROWTH, RADIUS, make_ball

from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, dress, follow, sweep
from tryon_jax.physics.state import SolverSettings

FACES, UV = sheet(10, 10, 0.4, 0.4)
CLOTH = make_cloth(FACES, UV, np.float32, bucket=128)
FABRIC = make_fabric(warp=200.0, shear=60.0, bending=2e-5, density=0.2, thickness=0.004, friction=0.3)
SETTINGS, EQUILIBRIUM = SolverSettings(), Equilibrium()


@pytest.fixture(scope="module")
def obstacle() -> Obstacle:
    return Obstacle(make_ball())


@pytest.fixture(scope="module")
def drape(obstacle: Obstacle) -> Drape:
    start = horizontal(UV, RADIUS + 0.005)
    return dress(start, CLOTH, FABRIC, obstacle, SETTINGS, EQUILIBRIUM, betas=(0.0,))


def height_over_ball(drape: Drape) -> np.ndarray:
    return np.linalg.norm(drape.vertices, axis=1) - RADIUS - GROWTH * drape.betas[0]


def test_it_comes_to_rest_outside(drape: Drape) -> None:
    assert drape.converged(EQUILIBRIUM)
    assert float(drape.report.residual) <= EQUILIBRIUM.tolerance
    assert 10 < int(drape.report.steps) < 400
    assert drape.vertices.shape == UV.shape[:1] + (3,)
    over = height_over_ball(drape)
    # The ball's facets lie up to half a millimetre inside the round one.
    assert over.min() > 0.002
    assert -float(drape.report.depth) > 0.002
    # It rests on the top and its corners hang below the ball's middle... or nearly.
    middle = np.linalg.norm(UV - 0.2, axis=1).argmin()
    assert 0.003 < over[middle] < 0.005
    corners = drape.vertices[[0, 10, 110, 120]]
    assert (corners[:, 1] < 0.1).all()
    assert np.ptp(corners[:, 1]) < 0.02


def test_padding_stays_away(drape: Drape) -> None:
    padding = np.asarray(drape.state.x)[len(UV) :]
    assert (padding == 5.0).all()


def test_a_sweep_follows_the_body(obstacle: Obstacle, drape: Drape) -> None:
    ray = np.array([[0.5], [1.0], [1.5]])
    before = drape.vertices.copy()
    drapes = list(sweep(drape, ray, CLOTH, FABRIC, obstacle, SETTINGS, EQUILIBRIUM))
    top = before[:, 1].argmax()
    for step, betas in zip(drapes, ray, strict=True):
        assert step.converged(EQUILIBRIUM)
        np.testing.assert_array_equal(step.betas, betas)
        assert height_over_ball(step).min() > 0.002
        rise = step.vertices[top, 1] - before[top, 1]
        assert rise == pytest.approx(GROWTH * betas[0], abs=1e-3)
    # Nothing that was handed in has changed, and a shape does not depend on those after it.
    np.testing.assert_array_equal(drape.vertices, before)
    again = follow(drape, ray[0], CLOTH, FABRIC, obstacle, SETTINGS, EQUILIBRIUM)
    np.testing.assert_array_equal(again.vertices, drapes[0].vertices)
    # Back on the path: friction leaves it elsewhere, but not far.
    back = list(sweep(drapes[-1], ray[::-1][1:], CLOTH, FABRIC, obstacle, SETTINGS, EQUILIBRIUM))[-1]
    apart = np.linalg.norm(back.vertices - drapes[0].vertices, axis=1)
    assert apart.mean() < 0.01


def test_steps_are_limited_and_reported(obstacle: Obstacle, drape: Drape) -> None:
    hurried = dataclasses.replace(EQUILIBRIUM, tolerance=0.0, max_steps=7, refresh=3)
    moved = follow(drape, np.array([2.0]), CLOTH, FABRIC, obstacle, SETTINGS, hurried)
    assert int(moved.report.steps) == 7
    assert not moved.converged(hurried)
    assert int(moved.report.iterations) > 7


def test_a_drape_that_left_the_numbers_is_an_error(obstacle: Obstacle) -> None:
    nonsense = dataclasses.replace(FABRIC, bending=jnp.full((3, 5), jnp.nan))
    with pytest.raises(ValueError, match=r"diverged after \d+ steps: fabric 'linear', 121 vertices, betas \[0.0\]"):
        dress(horizontal(UV, 0.3), CLOTH, nonsense, obstacle, SETTINGS, EQUILIBRIUM, betas=(0.0,), max_steps=40)


def test_the_obstacles_shape(obstacle: Obstacle) -> None:
    for beta in (0.0, 3.0, -4.0):
        radius = np.linalg.norm(obstacle.surface(np.array([beta])).vertices, axis=1)
        np.testing.assert_allclose(radius, RADIUS + GROWTH * beta, rtol=1e-4)
        np.testing.assert_allclose(np.linalg.norm(obstacle.skin(np.array([beta])), axis=1), radius, rtol=1e-6)
