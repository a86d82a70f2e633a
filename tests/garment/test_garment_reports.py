"""The contact sheet and the comparison of triangulations run and say what they measured."""

import json
from pathlib import Path

import pytest

from benchmarks import remesh as benchmark
from experiments.data import pattern_sheet
from tryon_jax.garment import load_design_space


@pytest.mark.slow
def test_the_contact_sheet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sheet.png"
    pattern_sheet.main(pattern_sheet.Config(out=out, split="unseen"))
    assert out.read_bytes()[:4] == b"\x89PNG"
    record = json.loads(out.with_suffix(".json").read_text())
    assert [row["design"] for row in record["designs"]][:2] == ["unseen-tank", "unseen-tshirt"]
    assert all(abs(row["mean_area"] / 1.78e-4 - 1) < 0.005 for row in record["designs"])
    assert record["environment"]["scipy"]
    assert "unseen-maxi-dress" in capsys.readouterr().out


def test_the_contact_sheet_knows_its_splits() -> None:
    with pytest.raises(ValueError, match="unknown split 'test'"):
        pattern_sheet.main(pattern_sheet.Config(split="test"))


@pytest.mark.parametrize("method", benchmark.METHODS)
def test_methods_are_measured_alike(method: str) -> None:
    config = benchmark.Config(designs=1, repeats=1, target_area=1.78e-3)
    row = benchmark.compare(load_design_space(), method, config)
    assert row["failures"].endswith("of 1")
    assert row["median angle"] > 35
    assert row["tank, ms"] > 0
