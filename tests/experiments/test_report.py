"""Records and the page made of them: verdicts follow from the numbers, what is missing is said to be missing."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from experiments import report
from experiments.paper import collisions, materials, memory, new_topologies
from experiments.paper.accuracy import ROWS, aims, markdown
from experiments.shared.errors import Errors
from experiments.shared.record import read_result, stages_trained, write_result
from tryon_jax.nets.store import save_store


@dataclass(frozen=True)
class Options:
    data: Path = Path("somewhere/private")
    shapes: int = 3


def accuracy_results():
    errors = Errors()
    errors.add(np.full((2, 10), 0.0031), np.array([False, True]))
    rows = {"pipeline": {"gray-interlock": errors.summary()}, "spread": {"gray-interlock": errors.summary()}}
    return {"garments": {"as trained": 2, "unseen topology": 0}, "table": {"as trained": rows, "unseen topology": {}}}


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


def test_the_accuracy_table_shows_what_was_measured():
    lines = "\n".join(markdown(accuracy_results()))
    assert "3.10 · 3.2 · 3.1" in lines
    assert ROWS["pipeline"] in lines
    assert ROWS["transfer"] not in lines
    assert "**unseen topology**: nothing simulated, not measured" in lines


def test_aims_are_judged_by_the_numbers_beside_them():
    results = accuracy_results()
    lines = "\n".join(markdown(results))
    assert "| trained design and topology, mm | 3.10 | at most 2 | not reached |" in lines
    assert "| unseen topology ÷ trained ones of that design | – | at most 1.05 | not measured |" in lines
    assert "| ends of the range ÷ mean | 1.00 | at most 1.5 | reached |" in lines
    assert "(short training, see Ablation) | – |" in lines
    results["table"]["unseen design"] = {
        "pipeline": {"a": {"mean_mm": 4.5}, "b": {"mean_mm": 3.9}},
        "neighbours": {"a": {"mean_mm": 6.0}, "b": {"mean_mm": 6.0}},
        "neighbours, design": {"a": {"mean_mm": 4.0}, "b": {"mean_mm": 4.0}},
    }
    results["held_out_block"] = {"ratio": 1.6}
    lines = "\n".join(aims(results))
    assert "| unseen design, mm | 4.20 | at most 3 | not reached |" in lines
    # The better of the two kNN counts.
    assert "| unseen design ÷ the better kNN | 1.05 | at most 0.8 | not reached |" in lines
    assert "(short training, see Ablation) | 1.60 | at most 1.5 | not reached |" in lines


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


@pytest.mark.parametrize(("value", "verdict"), [(10.2, "supported: unseen"), (12.0, "not supported: unseen")])
def test_the_verdict_on_topologies(value, verdict):
    def entry(split, hausdorff):
        return {"split": split, "hausdorff_mm": [hausdorff], "vertex_mm": [1.0]}

    found = new_topologies.summarise([entry("training", 10.0), entry("test", value)])
    assert verdict in new_topologies.markdown(found)[-1]


@pytest.mark.parametrize(
    ("matrix", "verdict"), [([[3, 4], [5, 2]], ": supported"), ([[3, 4], [1, 2]], ": not supported")]
)
def test_the_verdict_on_materials(matrix, verdict):
    results = {
        "fabrics": ["a", "b"],
        "samples": 4,
        "distance_mm": matrix,
        "own_nearer_share": [1.0, 0.5],
        "fabrics_apart_mm": {"predicted": 1.0, "simulated": 2.0},
        "difference_correlation": 0.5,
        "folds": {
            f"{kind} {fabric}": {"curvature": value, "sharp": 2.0, "concave": 0.5}
            for kind, values in (("predicted", (1.0, 1.1)), ("simulated", (1.0, 1.3)))
            for fabric, value in zip("ab", values, strict=True)
        },
    }
    assert verdict in materials.markdown(results)[-3]
    # A third of the simulated difference on a logarithmic scale.
    assert "not supported (curvature of b ÷ a: 1.10 predicted, 1.30 simulated)" in materials.markdown(results)[-1]


def test_collisions_before_and_after():
    step = {"inside_training_percent": [2.0, 0.5], "inside_held_out_percent": [1.0, 1.1]}
    lines = "\n".join(collisions.markdown({"collision_step": {"x": step}, "measured": {}}))
    assert "| x, training garments | 2.000 | 0.500 | -75 % | -70 % |" in lines
    assert "| x, unseen garments | 1.000 | 1.100 | +10 % | -20 % |" in lines
    assert "not measured" in collisions.markdown({"collision_step": {}, "measured": {}})[0]
    row = {"samples": 3, "vertices_percent": 2.0, "surface_percent": 2.5, "mean_deepest_mm": 1.0, "deepest_mm": 4.0}
    row |= {"simulation_vertices_percent": 0.0, "error_mm": 3.5}
    pushed = {"pushed_out_inside_percent": 0.0, "pushed_out_largest_move_mm": 5.0, "pushed_out_error_mm": 3.25}
    results = {"collision_step": {"x": step}, "measured": {"seen": row | pushed}, "measured_before": {"seen": row}}
    lines = "\n".join(collisions.markdown(results))
    assert "| seen (3 drapes), before the collision step | 2.00 | 2.50 | 1.0 · 4.0 | 0.00 | 3.50 |" in lines
    assert "| seen | 0.000 | 5.0 | 3.25 |" in lines


def test_memory_states_its_factor():
    results = {
        "weights": {"small": 1e6, "paper": 70e6, "fully connected": 167e6},
        "dense_layers": [5, 806, 51_738],
        "drapes": [],
    }
    lines = "\n".join(memory.markdown(results))
    assert "supported (factor 2.39)" in lines
    assert "not supported" in "\n".join(memory.markdown(results | {"weights": results["weights"] | {"paper": 72e6}}))
