"""Lowered arms of a dressed body: what is recorded, judged and refused; the simulation itself is in tests/physics."""

import numpy as np
import pytest

import tryon_jax as tj
from tests.flat_model import flat_model
from tryon_jax.body.stance import arms_pose
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
