"""Lowered arms of a dressed body: what is recorded, judged and refused; the simulation itself is in tests/physics."""

from dataclasses import replace

import numpy as np
import pytest

import tryon_jax as tj
from tests.flat_model import flat_model
from tests.tryon.test_learned_stance import with_stance
from tryon_jax.body.stance import arms_pose
from tryon_jax.wear.posing import pose_dressed
from tryon_jax.wear.simulate import Simulated, Simulator


@pytest.fixture(scope="module")
def session() -> tj.Session:
    return tj.Session(flat_model(), triangle_area=2.5e-3)


@pytest.fixture
def carried(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A simulator that leaves the cloth where it is and notes the angles that were asked for."""
    asked: list[float] = []

    def lower(self, vertices, pattern, fabric, betas, weights, degrees, progress=None) -> Simulated:
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-6)
        asked.append(degrees)
        return Simulated(vertices, 0.005, 0.01, 60, np.zeros(len(vertices)))

    monkeypatch.setattr(Simulator, "lower_arms", lower)
    return asked


def test_the_body_stands_with_its_arms_down_and_keeps_its_fit(session: tj.Session, carried: list[float]) -> None:
    dressed = session.judge(session.drape(session.prepare("tank"), (0.5, -0.5)))
    standing = tj.lower_arms(session, dressed, 30.0, outside=False)
    assert carried == [30.0]
    assert standing.arms == 30.0
    expected, _ = tj.pose_body(session.body, dressed.body.betas, arms_pose(session.body, 30.0).astype(np.float32))
    np.testing.assert_allclose(standing.body.vertices, expected, atol=1e-6)
    assert standing.fit is dressed.fit
    assert standing.verdict is not None
    assert standing.simulated is not None
    np.testing.assert_array_equal(standing.vertices, dressed.vertices)


def test_what_is_inside_the_lowered_body_is_pushed_out(session: tj.Session, carried: list[float]) -> None:
    dressed = session.drape(session.prepare("tank"))
    standing = tj.lower_arms(session, dressed, 20.0)
    assert standing.pushed is not None
    assert standing.fit is None, "none was measured in T-pose"


def test_what_makes_no_sense_is_refused(session: tj.Session, carried: list[float]) -> None:
    dressed = session.drape(session.prepare("tank"))
    with pytest.raises(ValueError, match="arms = 80"):
        tj.lower_arms(session, dressed, 80.0)
    assert not carried, "before any work"
    standing = tj.lower_arms(session, dressed, 20.0, outside=False)
    with pytest.raises(ValueError, match="20 degrees below the horizontal already"):
        tj.lower_arms(session, standing, 30.0)


@pytest.fixture(scope="module")
def learned(session: tj.Session) -> tj.Session:
    """A session whose model has an R_stance that moves the cloth."""
    return tj.Session(with_stance(session.model), triangle_area=2.5e-3)


def test_a_learned_drape_is_lowered_by_the_networks(learned: tj.Session, carried: list[float]) -> None:
    dressed = learned.drape(learned.prepare("tank"), (0.5, -0.5))
    standing = tj.lower_arms(learned, dressed, 30.0, outside=False)
    assert not carried, "no simulation"
    assert standing.arms == 30.0
    np.testing.assert_array_equal(standing.vertices, learned.stand(dressed, 30.0)[0])
    _, skinned = pose_dressed(
        learned.body,
        dressed.body.vertices,
        dressed.vertices,
        learned.skinning(dressed.garment),
        arms_pose(learned.body, 30.0).astype(np.float32),
    )
    change = np.linalg.norm(standing.vertices - skinned, axis=1)
    assert 1e-4 < change.mean() < 0.1
    raised = tj.lower_arms(learned, dressed, 0.0, outside=False)
    np.testing.assert_allclose(raised.vertices, dressed.vertices, atol=2e-6)


def test_the_simulator_lowers_what_it_draped_or_is_asked_for(learned: tj.Session, carried: list[float]) -> None:
    dressed = learned.drape(learned.prepare("tank"))
    tj.lower_arms(learned, dressed, 20.0, simulate=True, outside=False)
    refined = replace(dressed, simulated=Simulated(dressed.vertices, 0.005, 0.01, 60, np.zeros(len(dressed.vertices))))
    tj.lower_arms(learned, refined, 25.0, outside=False)
    assert carried == [20.0, 25.0]


def test_what_is_learned_is_pushed_out_too(learned: tj.Session) -> None:
    dressed = learned.drape(learned.prepare("tank"))
    standing = tj.lower_arms(learned, dressed, 45.0)
    assert standing.pushed is not None
    assert standing.pushed.is_outside
