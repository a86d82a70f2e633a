"""What runs on the host round compiled parts: drapes side by side, what compiles apart from what runs; the push-out."""

import dataclasses

import pytest

from benchmarks._machine import Ceilings
from benchmarks._pieces import measured
from benchmarks._subjects import Cell
from benchmarks.compare import Config, measure_cell

FAST = Ceilings({"float32": 1e3, "bfloat16": 1e3}, 1e2)


@pytest.mark.slow
def test_drapes_side_by_side_are_checked_and_timed(unchecked):
    config = Config(repeats=3, cell_seconds=0.1, max_call_seconds=30.0, peers=False)
    entry = measure_cell(Cell("side by side", "", 300, 2), config, FAST)
    assert entry["first_s"] > entry["compile_s"] > 0
    assert entry["per_second"] == pytest.approx(2e3 / entry["ms"])
    assert entry["solver_steps"] > 1
    assert entry["compilations_afterwards"] == 0
    late = dataclasses.replace(config, max_lanes_seconds=1e-9)
    again = measure_cell(Cell("side by side", "", 300, 2), late, FAST)
    assert "drapes would take up to" in again["skipped"]
    assert again["round_s"] > 0
    assert not measured(again, {"max_lanes_seconds": 100.0})
    assert measured(again, {"max_lanes_seconds": 1e-9})
    slow = Ceilings({"float32": 1e-3}, 1e-3)
    assert "one call would take" in measure_cell(Cell("side by side", "", 300, 2), config, slow)["skipped"]


def test_the_push_out_is_checked_and_timed():
    config = Config(repeats=3, cell_seconds=0.1)
    pushed = measure_cell(Cell("push-out", "", 300, 1), config, FAST)
    assert pushed["rounds"] > 0
    assert pushed["ms"] > 0
