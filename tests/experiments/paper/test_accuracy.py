"""The accuracy table where every error is known: predictions moved by millimetres, drapes that all move alike."""

import numpy as np
import pytest

from experiments.paper import accuracy, accuracy_table
from experiments.shared.record import read_result
from tests.experiments.accuracy_record import accuracy_results
from tests.experiments.known_data import FABRICS, TEST, write_known
from tryon_jax.training.dataset import load_arrays, ray_path

PLACES = {"as trained": 1.0, "unseen topology": 2.0, "unseen design": 0.0, accuracy_table.TWINS: 1.0}
"""Error of each case, millimetres: the offset of its one garment."""


def run_accuracy(config):
    accuracy.main(config)
    record = read_result(config.out, "accuracy")
    assert record is not None
    assert record["results"]["garments"] == dict.fromkeys(PLACES, 1)
    return record["results"]["table"]


@pytest.mark.slow
def test_the_pipelines_error_is_the_distance_that_the_drapes_were_moved(known, tmp_path):
    def dressed(_name, _fabric, _mean, predicted):
        return predicted.fine + np.array([0.0, 3e-3, 0.0])

    other = write_known(tmp_path / "dressed", known.model, dressed)
    table = run_accuracy(accuracy.Config(known.data, known.run, dressed=other, out=tmp_path, refine=1))
    for case, offset in PLACES.items():
        for fabric in FABRICS:
            found = {row: by_fabric[fabric] for row, by_fabric in table[case].items()}
            # The test shapes alone, of which one is the end of its ray.
            assert found["pipeline"]["samples"] == TEST.sum()
            assert found["pipeline"]["mean_mm"] == pytest.approx(offset, abs=1e-3)
            assert found["pipeline"]["ends_mm"] == pytest.approx(offset, abs=1e-3)
            # To a bin of 0.1 mm.
            assert found["pipeline"]["p95_mm"] == pytest.approx(offset + 0.05, abs=0.06)
            assert found["simulation"]["mean_mm"] == 0.0
            # A constant offset has no folds.
            assert found["pipeline"]["wrinkles_total"] == pytest.approx(1.0, abs=1e-3)
            if offset == 0.0:
                # Rounding may move one of a hundred vertices across the skin.
                assert found["pipeline"]["inside_percent"] == pytest.approx(
                    found["simulation"]["inside_percent"], abs=1
                )
            # A step of the solver moves cloth that does not rest; trained garments are not refined.
            assert ("refined" in found) == case.startswith("unseen")
            if "refined" in found:
                assert found["refined"]["samples"] == TEST.sum()
                assert found["refined"]["mean_mm"] > offset
            assert found["dressed"]["mean_mm"] == pytest.approx(3.0, abs=1e-3)
            assert found["dressed, simulation"]["mean_mm"] == pytest.approx(np.hypot(offset, 3.0), abs=1e-3)


@pytest.mark.slow
def test_baselines_are_exact_where_all_drapes_move_alike(known, tmp_path):
    """Every garment 10 mm above its mean drape, the unseen topology 1 mm more to the side."""
    extra = {"tshirt-0": 0.0, "tshirt-100": 1e-3, "unseen-tshirt-0": 0.0}

    def lifted(name, _fabric, mean, predicted):
        return np.broadcast_to(mean, predicted.fine.shape) + np.array([extra[name], 0.01, 0.0])

    data = write_known(tmp_path / "lifted", known.model, lifted)
    table = run_accuracy(accuracy.Config(data, known.run, out=tmp_path, refine=0))
    for fabric in FABRICS:
        for case, name in (("as trained", "tshirt-0"), ("unseen topology", "tshirt-100")):
            mean = {row: by_fabric[fabric]["mean_mm"] for row, by_fabric in table[case].items() if fabric in by_fabric}
            assert mean["mean drape"] == pytest.approx(np.hypot(10.0, 1e3 * extra[name]), abs=1e-3)
            assert mean["neighbours"] == pytest.approx(1e3 * extra[name], abs=1e-3)
            assert mean["neighbours, design"] == pytest.approx(1e3 * extra[name], abs=1e-3)
            assert mean["kriging"] == pytest.approx(1e3 * extra[name], abs=0.05)
        # Displacements of the trained topology, at the vertices of the other.
        assert table["unseen topology"]["spread"][fabric]["mean_mm"] == pytest.approx(1.0, abs=1e-3)
        # Smoothing keeps what is constant: the target lies as far above the smoothed mean drape.
        assert table["as trained"]["smooth, own target"][fabric]["mean_mm"] > 5.0


@pytest.mark.slow
def test_drapes_in_the_belly_are_inside_the_body(known, tmp_path):
    def swallowed(_name, _fabric, _mean, predicted):
        return 0.01 * (predicted.fine - predicted.fine.mean(axis=(0, 1))) + np.array([0.0, 0.1, 0.0])

    data = write_known(tmp_path / "inside", known.model, swallowed)
    drape = load_arrays(ray_path(data, "tshirt-0", FABRICS[0], 0))["vertices"][0]
    assert np.ptp(drape, axis=0).max() < 0.02
    table = run_accuracy(accuracy.Config(data, known.run, out=tmp_path, refine=0))
    assert table["as trained"]["simulation"][FABRICS[0]]["inside_percent"] == 100.0
    assert table["as trained"]["pipeline"][FABRICS[0]]["inside_percent"] < 100.0


def test_the_accuracy_table_shows_what_was_measured():
    lines = "\n".join(accuracy_table.markdown(accuracy_results()))
    assert "3.10 · 3.2 · 3.1" in lines
    assert accuracy_table.ROWS["pipeline"] in lines
    assert accuracy_table.ROWS["transfer"] not in lines
    assert "**unseen topology**: nothing simulated, not measured" in lines


def test_aims_are_judged_by_the_numbers_beside_them():
    results = accuracy_results()
    lines = "\n".join(accuracy_table.markdown(results))
    assert "| trained design and topology, mm | 3.10 | at most 2 | not reached |" in lines
    assert "| unseen topology ÷ trained ones of that design | – | at most 1.05 | not measured |" in lines
    assert "| ends of the range ÷ mean | 1.00 | at most 1.5 | reached |" in lines
    results["table"]["unseen design"] = {
        "pipeline": {"a": {"mean_mm": 4.5}, "b": {"mean_mm": 3.9}},
        "neighbours": {"a": {"mean_mm": 6.0}, "b": {"mean_mm": 6.0}},
        "neighbours, design": {"a": {"mean_mm": 4.0}, "b": {"mean_mm": 4.0}},
    }
    lines = "\n".join(accuracy_table.aims(results))
    assert "| unseen design, mm | 4.20 | at most 3 | not reached |" in lines
    # The better of the two kNN counts.
    assert "| unseen design ÷ the better kNN | 1.05 | at most 0.8 | not reached |" in lines
