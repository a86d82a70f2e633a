"""The short run on a GPU, on a CPU with a clock of its own: order, shares of time, going on, what is refused."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import _comparison, float64, gpu
from benchmarks._calls import summary
from benchmarks._machine import Ceilings
from benchmarks._pieces import RUNNING
from benchmarks._plan import simulator_cells, throughput_cells
from benchmarks._subjects import Cell
from benchmarks.gpu import NO_TRITON, Config, Steps, has_card, is_slow, run, said, set_flags
from tryon_jax.training.dataset import load_arrays, save_arrays

CELLS = len(throughput_cells(("small",), (300,), (1, 4), 300, 4))


class Run:
    """A run whose cells take as many seconds as they are told to, and whose order is kept."""

    def __init__(self, cell_seconds: float = 10.0) -> None:
        self.now, self.cell_seconds, self.done = 0.0, cell_seconds, []
        self.lose: Cell | None = None
        self.fail: Cell | None = None
        self.time_left: float | None = None

    def check(self):
        self.done.append("check")
        self.now += 5.0
        return {"error_mm": 1e-4, "tolerance_mm": 0.01}

    def measure(self, cell, limits, ceilings):
        assert limits.resume
        assert isinstance(ceilings, Ceilings)
        self.done.append(cell)
        self.now += self.cell_seconds
        if cell == self.lose:
            raise KeyboardInterrupt
        if cell == self.fail:
            raise RuntimeError("out of memory")
        return dataclasses.asdict(cell) | summary([0.001] * 3, cell.batch, None) | {"beside": {}, "compile_s": 1.0}

    def train(self, *given):
        self.done.append("training")
        self.time_left = given[-1]
        return {"state": "smooth: time was over", "stages": {}, "compared": []}

    def steps(self) -> Steps:
        return Steps(lambda: self.now, self.check, self.measure, self.train)


@pytest.fixture(autouse=True)
def fast(monkeypatch):
    """No time for ceilings and profiles, which have tests of their own."""
    monkeypatch.setattr(_comparison, "measure_ceilings", lambda *_: Ceilings({"float32": 1e3}, 1e2))
    monkeypatch.setattr(gpu, "profile_of", lambda *_: {"seconds": 1.0})
    monkeypatch.setattr(gpu, "check_data", lambda *_: None)


def config_of(tmp_path: Path, **changes) -> Config:
    small = {"configs": ("small",), "vertices": (300,), "batches": (1, 4), "at_vertices": 300, "at_batch": 4}
    return Config(tmp_path, **(small | {"lanes": (1, 2), "quick": True, "data": tmp_path} | changes))


def record_in(folder: Path) -> dict:
    [path] = folder.glob("gpu-*.json")
    return json.loads(path.read_text())


def test_what_tells_most_is_measured_first():
    cells = throughput_cells(("small", "paper"), (1414, 3581, 14_000, 100_000), (1, 64, 4096), 3581, 64)
    assert len(set(cells)) == len(cells)
    assert cells[0] == Cell("drape with fields", "small", 3581, 64)
    firsts = [c for c in cells if (c.vertices, c.batch) in ((3581, 64), (3581, 1)) and cells.index(c) < 20]
    assert {c.subject for c in firsts} == {c.subject for c in cells}
    assert {c.batch for c in cells if c.subject == "drape"} == {1, 64, 4096}
    assert {c.vertices for c in cells if c.subject == "drape"} == {1414, 3581, 14_000, 100_000}
    assert {c.precision for c in cells if c.subject == "drape with fields"} == {"float32", "tf32"}
    assert cells[-1].vertices == 100_000
    assert max(c.vertices for c in cells if c.subject == "push-out") == 14_000
    sides = simulator_cells(3581, (256, 1, 16, 64))
    assert [c.batch for c in sides] == [1, 1, 16, 16, 64, 64, 256, 256]
    assert {c.subject for c in sides} == {"solver step", "side by side"}


def test_each_part_has_its_share_and_the_rest_trains(tmp_path):
    one = Run()
    record = run(config_of(tmp_path, minutes=10.0), one.steps())
    assert one.done[0] == "check"
    assert one.done[-1] == "training"
    assert one.done[1 : 1 + CELLS] == throughput_cells(("small",), (300,), (1, 4), 300, 4)
    assert one.done[1 + CELLS : -1] == simulator_cells(300, (1, 2))
    assert one.time_left == pytest.approx(600 - 5 - 10 * (CELLS + 4))
    [piece] = record["pieces"]
    assert piece["parts_s"] == {"check": 5, "throughput": 10 * CELLS, "simulator": 40, "training": 0}
    assert record["check"]["error_mm"] == 1e-4
    assert "training: smooth: time was over" in said(record)


def test_a_part_that_is_over_leaves_the_others_their_time(tmp_path):
    slow = Run(cell_seconds=20.0)
    config = config_of(tmp_path, minutes=5.0, check_share=0.1, throughput_share=0.3, simulator_share=0.3)
    record = run(config, slow.steps())
    # 120 s for check and throughput, of which 5 are gone: five cells of 20 s, and a sixth would not fit.
    assert [isinstance(step, Cell) for step in slow.done[1:6]] == [True] * 5
    assert slow.done[6:-1] == simulator_cells(300, (1, 2))
    assert slow.now <= 0.7 * 300
    assert slow.time_left == pytest.approx(300 - slow.now)
    cut = [entry for entry in record["cells"] if entry.get("skipped") == "the 5 minutes were over"]
    assert len(cut) == CELLS - 5
    # The next run begins with what was cut off.
    after = Run(cell_seconds=1.0)
    record = run(config, after.steps())
    assert len(after.done) == 1 + CELLS - 5 + 1
    assert all("ms" in entry for entry in record["cells"])
    assert len(record["pieces"]) == 2


def test_a_lost_run_loses_no_cell_and_tries_the_fatal_one_last(tmp_path):
    lost = Run()
    cells = throughput_cells(("small",), (300,), (1, 4), 300, 4)
    lost.lose = cells[2]
    config = config_of(tmp_path, minutes=60.0)
    with pytest.raises(KeyboardInterrupt):
        run(config, lost.steps())
    entries = record_in(tmp_path)["cells"]
    assert ["ms" in entry for entry in entries[:3]] == [True, True, False]
    assert entries[2]["skipped"] == RUNNING
    after = Run()
    run(config, after.steps())
    assert after.done[1 : CELLS - 1] == [*cells[3:], cells[2]]
    assert all("ms" in entry for entry in record_in(tmp_path)["cells"])


def test_a_failed_cell_costs_no_other_and_is_told_at_the_end(tmp_path):
    one = Run()
    one.fail = throughput_cells(("small",), (300,), (1, 4), 300, 4)[1]
    with pytest.raises(RuntimeError, match=r"1 cells failed, the first: .*out of memory"):
        run(config_of(tmp_path, minutes=60.0), one.steps())
    assert one.done[-1] == "training"
    after = Run()
    run(config_of(tmp_path, minutes=60.0), after.steps())
    assert after.done == ["check", one.fail, "training"]


def test_numbers_of_other_versions_and_options_are_not_mixed(tmp_path, monkeypatch):
    run(config_of(tmp_path, minutes=1.0), Run().steps())
    before = record_in(tmp_path)
    with pytest.raises(ValueError, match="begun with repeats = 15, now it is 3"):
        run(config_of(tmp_path, repeats=3), Run().steps())
    real = gpu.surroundings()
    for name, value in (("jaxlib", "0.0.1"), ("cpu_cores", 999), ("xla_flags", NO_TRITON)):
        monkeypatch.setattr(_comparison, "surroundings", lambda name=name, value=value: real | {name: value})
        refused = Run()
        with pytest.raises(ValueError, match=f"begun with {name} = "):
            run(config_of(tmp_path), refused.steps())
        assert refused.done == []
    assert record_in(tmp_path) == before
    # Another card begins a record of its own.
    other = real | {"device": "Another Card"}
    monkeypatch.setattr(_comparison, "surroundings", lambda: other)
    monkeypatch.setattr(gpu, "surroundings", lambda: other)
    run(config_of(tmp_path), Run().steps())
    assert (tmp_path / "gpu-another-card.json").exists()


def test_nothing_is_measured_where_the_check_fails(tmp_path):
    one = Run()

    def check():
        raise ValueError("the drape is 3 mm from float64")

    with pytest.raises(ValueError, match="3 mm from float64"):
        run(config_of(tmp_path), dataclasses.replace(one.steps(), check=check))
    assert one.done == []


def test_the_first_that_is_slower_than_cpus_is_profiled(tmp_path, monkeypatch):
    monkeypatch.setattr(gpu, "cpu_seconds", lambda _: 16 * 0.4e-3)
    record = run(config_of(tmp_path, minutes=60.0, lanes=(1, 2, 4)), Run().steps())
    # A call takes 1 ms: one drape a call is slower than 0.4 ms each, four are not.
    profiled = [(e["subject"], e["batch"]) for e in record["cells"] if "profile" in e]
    assert profiled == [("side by side", 1)]
    assert is_slow({"vertices": 300, "skipped": "too long", "needs": {"max_lanes_seconds": 99.0}})
    assert not is_slow({"vertices": 300, "skipped": "the 9 minutes were over"})
    monkeypatch.undo()
    assert 0.05 < gpu.cpu_seconds(3581) < 100
    assert gpu.cpu_seconds(17) is None


def test_flags_are_set_for_cards_alone():
    environment = {"XLA_FLAGS": "--xla_dump_to=x"}
    set_flags(environment, card=False)
    assert environment == {"XLA_FLAGS": "--xla_dump_to=x"}
    set_flags(environment, card=True)
    assert environment == {"XLA_FLAGS": f"--xla_dump_to=x {NO_TRITON}"}
    own = {"XLA_FLAGS": "--xla_gpu_enable_triton_gemm=true"}
    set_flags(own, card=True)
    assert own == {"XLA_FLAGS": "--xla_gpu_enable_triton_gemm=true"}
    assert not has_card({"JAX_PLATFORMS": "cpu"})


KEPT = """
import sys
from pathlib import Path
import jax
from benchmarks._machine import counting_compilations
from benchmarks.gpu import keep_compiled
keep_compiled(Path(sys.argv[1]) / "compiled")
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
for _ in range(2):
    with counting_compilations() as found:
        jax.jit(lambda x: jax.numpy.cos(x) * 3 + x)(jax.numpy.ones(7))
    print(found.from_cache > 0)
    jax.clear_caches()
"""


def test_what_was_compiled_is_kept_and_counted(tmp_path):
    command = [sys.executable, "-c", KEPT, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(gpu.__file__).parents[1], check=True)
    assert done.stdout.split() == ["False", "True"]
    assert list((tmp_path / "compiled").iterdir())


def test_shares_of_more_than_all_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"add up to 1\.5"):
        gpu.main(config_of(tmp_path, check_share=0.5, throughput_share=0.5, simulator_share=0.5))
    with pytest.raises(ValueError, match="minutes"):
        gpu.main(config_of(tmp_path, minutes=0.0))


def test_the_stored_drape_is_float64_and_this_device_agrees():
    stored = load_arrays(float64.STORED)
    assert stored["drape"].dtype == np.float64
    assert float64.STORED.stat().st_size < 100_000
    found = float64.check_drape()
    assert 0 < found["error_mm"] < 0.01
    assert found["vertices"] == len(stored["mean"])


def test_another_drape_and_other_weights_are_noticed(tmp_path):
    stored = load_arrays(float64.STORED)
    moved = stored["drape"].copy()
    moved[7, 1] += 2e-5
    save_arrays(tmp_path / "moved.npz", stored | {"drape": moved})
    with pytest.raises(ValueError, match=r"is 0\.02 mm from float64"):
        float64.check_drape(tmp_path / "moved.npz")
    save_arrays(tmp_path / "old.npz", stored | {"weights": np.array("0")})
    with pytest.raises(ValueError, match="of other weights"):
        float64.check_drape(tmp_path / "old.npz")
