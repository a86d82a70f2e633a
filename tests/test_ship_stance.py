"""R_stance goes into the package whole, or not at all where it tears a garment."""

from pathlib import Path

import pytest

from tools import ship_stance
from tryon_jax.nets.store import read_record
from tryon_jax.tryon.model_file import STANCE, pretrained_path

pytestmark = pytest.mark.slow
SHIPPED = pretrained_path(f"small{STANCE}")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(ship_stance, "DESIGNS", 2)
    monkeypatch.setattr(ship_stance, "MODELS", tmp_path)
    monkeypatch.setattr(ship_stance, "TORN", 1.2)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "stance.safetensors").write_bytes(SHIPPED.read_bytes())
    return tmp_path / "run"


def test_what_is_shipped_can_be_shipped_again(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ship_stance.main(run)
    written = run.parent / SHIPPED.name
    assert read_record(written)["training"] == read_record(SHIPPED)["training"]
    # It was in half precision: nothing is lost this time.
    assert written.stat().st_size == pytest.approx(SHIPPED.stat().st_size, rel=0.01)
    assert "moves vertices by 0.000 mm at most: used" in capsys.readouterr().out


def test_weights_that_tear_are_refused(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ship_stance, "TORN", 0.05)
    with pytest.raises(ValueError, match=r"stance\.safetensors tears sleeve_length"):
        ship_stance.main(run)
    assert not (run.parent / SHIPPED.name).exists()
