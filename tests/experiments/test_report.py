"""Records and the page made of them: verdicts follow from the numbers, what is missing is said to be missing."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments import report
from experiments.shared.record import read_result, stages_trained, write_result
from tests.experiments.accuracy_record import accuracy_results
from tryon_jax.nets.store import save_store


@dataclass(frozen=True)
class Options:
    data: Path = Path("somewhere/private")
    shapes: int = 3


def test_a_record_says_what_it_depends_on_and_no_paths(tmp_path):
    path = write_result(tmp_path, "thing", Options(), {"values": np.arange(3), "one": np.float32(0.5)})
    text = path.read_text()
    assert "private" not in text
    record = read_result(tmp_path, "thing")
    assert record is not None
    assert record["config"] == {"shapes": 3}
    assert record["results"] == {"values": [0, 1, 2], "one": 0.5}
    assert {"cpu", "jax", "date"} <= set(record["environment"])
    assert read_result(tmp_path, "another") is None


def test_untrained_stages_are_named(tmp_path):
    path = tmp_path / "model.safetensors"
    save_store(path, {"a": np.zeros(1, np.float32)}, {"training": {"mean": {}, "fine-x": {}}})
    assert stages_trained(path, ("x", "y")) == ["smooth", "fine-y"]


def test_the_page_has_each_record_and_lists_the_rest(tmp_path):
    results, page = tmp_path / "results", tmp_path / "RESULTS.md"
    model = {"sha256": "ab" * 32, "training": {"mean": {}, "smooth": {"steps": 7}}}
    dataset = {"checksum": "cd" * 32, "garments": 2}
    write_result(results, "accuracy", Options(), accuracy_results(), model=model, dataset=dataset)
    (results / "accuracy.png").write_bytes(b"")
    report.main(report.Config(results, page))
    text = page.read_text()
    assert "## Accuracy" in text
    assert "![Accuracy](results/accuracy.png)" in text
    assert "weights abababababab (mean, smooth 7 steps)" in text
    assert "dataset cdcdcdcdcdcd" in text
    assert "- Materials (`materials`)" in text
    assert "- Ablation (`ablation`)" in text
    assert "Claim of the paper: 71 MB" not in text
