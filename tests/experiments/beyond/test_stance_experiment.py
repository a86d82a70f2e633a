"""Arms down where the simulation is known: cloth that is skinned along is as far away as it is moved beside."""

from pathlib import Path

import numpy as np
import pytest

from experiments.beyond import stance
from experiments.shared.record import read_result
from tests.flat_model import flat_model
from tryon_jax.body.stance import LOWEST
from tryon_jax.physics.stance import StanceObstacle
from tryon_jax.wear.session import Session
from tryon_jax.wear.simulate import Simulated, Simulator


def test_distance_and_rank_of_a_known_descent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulator is one that skins the cloth and moves it 3 mm to the side in the space of the T-pose."""

    def lower(self, vertices, pattern, fabric, betas, weights, degrees, progress=None):
        obstacle = StanceObstacle(self.obstacle, betas)
        for after in np.linspace(0.0, degrees, 4)[1:]:
            moved = obstacle.carry(vertices + np.array([0.003, 0.0, 0.0]), weights, 0.0, after)
            progress(float(after), 0.005, moved.astype(np.float32))
        return Simulated(moved.astype(np.float32), 0.005, 0.01, 30, np.zeros(len(vertices)))

    monkeypatch.setattr(Simulator, "lower_arms", lower)
    monkeypatch.setattr(stance, "Session", lambda **_: Session(flat_model(), triangle_area=2.5e-3))
    monkeypatch.setattr(Session, "refine", lambda _, dressed: dressed)
    sheets = []
    monkeypatch.setattr(stance, "contact_sheet", lambda _path, items, **_: sheets.append(items))
    stance.main(stance.Config(("tank",), ("gray-interlock",), ((0.0, 0.0), (0.5, 0.5)), tmp_path))
    record = read_result(tmp_path, "stance")
    assert record is not None
    rows = record["results"]["stances"]
    assert [row["degrees"] for row in rows] == pytest.approx([LOWEST / 3, 2 * LOWEST / 3, LOWEST])
    for row in rows:
        assert row["skinned_mm"] == pytest.approx(3.0, abs=0.2)
        assert row["at_rest"] == 1.0
    rank = record["results"]["rank"]
    assert rank["0"] == pytest.approx(3.0, abs=0.01)
    assert rank["2"] == pytest.approx(0.0, abs=0.01)
    assert len(sheets[0]) == 2
    assert "| 45° |" in "\n".join(stance.markdown(record["results"]))
