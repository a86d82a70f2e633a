import json
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from benchmarks.record import write_record
from measuring.records import environment, table
from measuring.timing import Timing, measure


@dataclass(frozen=True)
class Config:
    batch: int = 4


def test_the_first_call_and_the_warmup_are_not_in_the_median():
    calls = []

    def work():
        calls.append(None)
        return {"a": jnp.ones(3)}

    timing = measure(work, repeats=5, warmup=2)
    assert len(calls) == 1 + 2 + 5
    assert timing.repeats == 5
    assert timing.lower_quartile <= timing.median <= timing.upper_quartile


def test_slow_work_is_cut_short_after_three_calls():
    assert measure(lambda: 0, repeats=1000, warmup=0, max_seconds=0.0).repeats == 3


def test_a_record_says_what_was_measured_where(tmp_path):
    timing = Timing(first=1.0, median=0.002, lower_quartile=0.001, upper_quartile=0.003, repeats=7)
    path = write_record("drape", Config(), [{"batch": 4, "time": timing, "x": jnp.ones(2)}], folder=tmp_path, note="n")
    record = json.loads(path.read_text())
    assert path.name.startswith("drape-")
    assert record["config"] == {"batch": 4}
    assert record["rows"][0]["time"]["median"] == 0.002
    assert record["rows"][0]["x"] == [1.0, 1.0]
    assert record["environment"]["jax"] == jax.__version__
    assert {"date", "device", "cpu", "cpu_cores", "python", "tryon_jax"} <= set(environment())


def test_table_is_markdown():
    timing = Timing(first=1.0, median=0.002, lower_quartile=0.001, upper_quartile=0.003, repeats=7)
    assert table([{"batch": 4, "rate": 1234.5, "time": timing}]).splitlines() == [
        "| batch | rate | time |",
        "|---|---|---|",
        "| 4 | 1234 | 2 ms (1 to 3) |",
    ]
