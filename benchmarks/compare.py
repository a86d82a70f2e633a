"""XLA on this device: one record that `python -m benchmarks report` sets beside those of other devices.

python -m benchmarks compare
python -m benchmarks compare --quick
python -m benchmarks compare --full --minutes 60
python -m benchmarks compare --full --minutes 60 --resume

The record is written after every cell, so that nothing measured is lost when it is stopped.
"""

import json
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from benchmarks import _simulation, _subjects
from benchmarks._garments import garment_of
from benchmarks._machine import (
    PRECISIONS,
    Ceilings,
    EnergyMeter,
    counting_compilations,
    measure_ceilings,
    supported,
    surroundings,
)
from benchmarks._networks import dense_floor
from benchmarks._pieces import LIMITS, cut_off, failed, measured, read_begun, too_large, too_long
from benchmarks._subjects import Cell, Work, config_of, tryon_model
from benchmarks.record import RESULTS
from measuring.records import plain, slug
from tryon_jax.checks import check_choice
from tryon_jax.files.atomic import write_text
from tryon_jax.garment import load_design_space
from tryon_jax.tryon import load_pretrained, prepare

SUBJECTS: dict[str, Callable[[Cell], Work]] = {
    "Laplacian product": _subjects.laplacian_product,
    "Chebyshev layer": _subjects.cheb_layer,
    "U-Net forward": _subjects.unet_forward,
    "U-Net gradient": _subjects.unet_gradient,
    "drape": _subjects.whole_drape,
    "training step": _subjects.training_step,
    "collision loss": _simulation.collision,
    "solver step": _simulation.solver_step,
}
"""What is compiled as one function; the full equilibrium and the preparation of a garment run on the host."""
NETWORKS = ("Laplacian product", "Chebyshev layer", "U-Net forward", "U-Net gradient", "drape", "training step")
ALL = (*SUBJECTS, "full equilibrium", "prepare")
PREPARED = {"tank": 1414, "maxi-dress": 3581}
"""Presets by their vertices at the working density."""
FLOORS = {"U-Net forward": (1, False), "U-Net gradient": (1, True), "drape": (2, False), "training step": (1, True)}
"""Subjects beside which their dense products alone are timed: number of networks, with derivatives."""


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks compare`."""

    subjects: tuple[str, ...] = ()
    """What to measure; everything when not given."""
    configs: tuple[str, ...] = ("small", "paper")
    """Sizes of the networks."""
    vertices: tuple[int, ...] = (1414, 3581, 14_000, 100_000)
    """Sizes of the garment, at `at_batch` shapes."""
    batches: tuple[int, ...] = (1, 8, 64, 256)
    """Body shapes in one call, at `at_vertices` vertices."""
    at_vertices: int = 3581
    at_batch: int = 8
    full: bool = False
    """Every size with every batch and every precision, in place of one sweep of each."""
    quick: bool = False
    """Two small sizes, two batches, `small` alone: minutes, to see that all is well."""
    minutes: float = 8.0
    """Nothing new is begun after this time; what is left is recorded as skipped."""
    resume: bool = False
    """Go on with the record of this device in `out`: measure only what time did not suffice for, and what larger
    limits let in."""
    max_call_seconds: float = 1.5
    """Cells whose one call would take longer, as predicted from the measured ceilings, are skipped."""
    max_gigabytes: float = 6.0
    """Cells that would need more memory are skipped."""
    repeats: int = 15
    """Timed calls of each kind."""
    cell_seconds: float = 2.5
    """Longest time for the timed calls of one cell, with three of each at least."""
    peers: bool = True
    """Measure SciPy, and PyTorch Geometric where it is installed."""
    out: Path = RESULTS
    """Folder of the record, named after the device."""


def plan(config: Config) -> list[Cell]:
    """The cells in the order in which they are measured: first the middle of each sweep, so that time cut short by
    `minutes` costs the ends."""
    vertices, batches, configs = config.vertices, config.batches, config.configs
    if config.quick:
        vertices, batches, configs = (1414, 3581), (1, 8), ("small",)
    middle = (config.at_vertices, config.at_batch)
    pairs = [middle, *((config.at_vertices, b) for b in batches), *((v, config.at_batch) for v in vertices)]
    if config.full:
        pairs += [(v, b) for v in vertices for b in batches]
    pairs = list(dict.fromkeys(pairs))
    subjects = [check_choice("subject", name, ALL) for name in config.subjects] or list(ALL)
    rounds: dict[Cell, int] = {}
    for subject in subjects:
        for name in configs if subject in NETWORKS else ("",):
            for turn, (v, b) in enumerate(pairs):
                if subject in ("full equilibrium", "prepare"):
                    b = 1
                rounds.setdefault(Cell(subject, name, v, b), turn)
                if subject in ("drape", "U-Net forward") and (config.full or (v, b) == middle):
                    for precision in PRECISIONS:
                        rounds.setdefault(Cell(subject, name, v, b, precision), turn)
    return sorted(rounds, key=lambda cell: rounds[cell])


def needed_gigabytes(cell: Cell) -> float:
    """Memory that a cell's activations need, roughly and rather too much."""
    if cell.subject not in NETWORKS:
        width = 3 * _simulation.LIST_LENGTH if cell.subject == "collision loss" else 12 * 40
    else:
        widths = config_of(cell).smooth.widths
        keep = "gradient" in cell.subject or "training" in cell.subject
        width = {"Laplacian product": 2 * widths[0], "Chebyshev layer": 5 * _subjects.LAYER_WIDTH[cell.config]}.get(
            cell.subject, 8 * widths[0] * (3 if keep else 1)
        )
    return 4e-9 * cell.vertices * 1.1 * cell.batch * width


def time_calls(calls: dict[str, Callable[[int], Any]], repeats: int, max_seconds: float) -> dict[str, list[float]]:
    """Seconds of calls taken in turns, so that the machine's other work meets all alike; each is told its turn."""
    for call in calls.values():
        jax.block_until_ready(call(0))
    times: dict[str, list[float]] = {name: [] for name in calls}
    begin, turn = time.perf_counter(), 0
    while turn < repeats and (turn < 3 or time.perf_counter() - begin < max_seconds):
        for name, call in calls.items():
            start = time.perf_counter()
            jax.block_until_ready(call(turn))
            times[name].append(time.perf_counter() - start)
        turn += 1
    return times


class Compiled:
    """A work's function compiled for leaves alone: unpacking pytrees is no part of what is timed."""

    def __init__(self, work: Work) -> None:
        self._fixed, fixed_tree = jax.tree.flatten(jax.device_put(work.fixed))
        self._inputs = [jax.tree.leaves(given) for given in work.inputs]
        inputs_tree = jax.tree.structure(work.inputs[0])

        def run(fixed: list[Any], given: list[Any]) -> Any:
            return work.function(*jax.tree.unflatten(fixed_tree, fixed), *jax.tree.unflatten(inputs_tree, given))

        self.executable = jax.jit(run).lower(self._fixed, self._inputs[0]).compile()

    def __call__(self, *arguments: Any) -> Any:
        """As the function itself: fixed arguments, then inputs."""
        leaves = jax.tree.leaves(arguments)
        count = len(self._fixed)
        return self.executable(leaves[:count], leaves[count:])

    def fresh(self, turn: int) -> Any:
        """With the inputs of this turn."""
        return self.executable(self._fixed, self._inputs[turn % len(self._inputs)])


def measure_cell(cell: Cell, config: Config, ceilings: Ceilings) -> dict[str, Any]:
    """Compile, check, time; one entry of the record."""
    entry: dict[str, Any] = asdict(cell)
    if not supported(cell.precision):
        return entry | {"skipped": f"the device has no {cell.precision}"}
    if cell.subject == "prepare":
        return entry | measure_preparation(cell, config)
    gigabytes = needed_gigabytes(cell)
    if gigabytes > config.max_gigabytes:
        return entry | too_large(gigabytes)
    if cell.subject == "full equilibrium":
        return entry | measure_equilibrium(cell, config, ceilings)
    work = SUBJECTS[cell.subject](cell)
    predicted = 3 * ceilings.floor(work.flops, work.moved, cell.precision)
    if predicted > config.max_call_seconds:
        return entry | too_long(predicted, predicted)
    with counting_compilations() as compiling:
        start = time.perf_counter()
        with jax.default_matmul_precision(PRECISIONS[cell.precision][1]):
            made = Compiled(work)
        seconds = time.perf_counter() - start
    entry |= {"compile_s": seconds, "compilations": compiling.count, "error": work.check(made), "unit": work.unit}
    if not entry["error"] <= work.tolerance:
        within = f"{entry['error']:.3g} {work.unit} from float64, more than {work.tolerance:g}"
        if cell.precision == "float32":
            raise ValueError(f"{cell} is wrong: {within}")
        return entry | {"skipped": f"not timed: {within}"}
    calls: dict[str, Callable[[int], Any]] = {"xla": made.fresh}
    if cell.subject in FLOORS and cell.precision == "float32":
        count, gradient = FLOORS[cell.subject]
        model = tryon_model(cell)
        nets = [model.smooth.net, model.fine[model.config.fabrics[0]].net][:count]
        nodes = garment_of(model.config, cell.vertices).graph.num_nodes
        with jax.default_matmul_precision(PRECISIONS[cell.precision][1]):
            floor = dense_floor(nets, nodes, cell.batch, gradient)
        calls["dense products"] = lambda _: floor()
    if config.peers:
        calls |= {name: lambda _, call=call: call() for name, call in work.peers.items()}
    times = time_calls(calls, config.repeats, config.cell_seconds)
    # Peers written in JAX compile at their first call: ours is called once more to see that it does not.
    with counting_compilations() as again:
        for turn in range(len(work.inputs)):
            jax.block_until_ready(calls["xla"](turn))
    megabytes = peak_megabytes(made.executable)
    at_ceiling = ceilings.floor(work.flops, work.moved, cell.precision, megabytes)
    entry |= summary(times["xla"], work.samples, at_ceiling)
    entry |= {
        "compilations_afterwards": again.count,
        "memory_mb": megabytes,
        **joules(calls["xla"], entry),
    }
    entry["beside"] = {name: [1e3 * t for t in values] for name, values in times.items() if name != "xla"}
    if cell.subject == "solver step":
        entry["linear_iterations"] = int(np.asarray(made.fresh(0)[2]).max())
        # The traffic was counted for an assumed number of iterations.
        entry["share_of_ceiling"] *= entry["linear_iterations"] / _simulation.CG_ITERATIONS
    return entry


def measure_equilibrium(cell: Cell, config: Config, ceilings: Ceilings) -> dict[str, Any]:
    """The same for the host's loop around the compiled solver."""
    rows, slots = cell.vertices * 1.1, 12
    predicted = 3 * _simulation.CG_ITERATIONS * 30 * 1e-9 * rows * slots * 40 / ceilings.bandwidth
    if predicted > config.max_call_seconds * 2:
        return too_long(predicted, predicted / 2)
    with counting_compilations() as compiling:
        start = time.perf_counter()
        work = _simulation.FullEquilibrium(cell)
        drape = work(0)
        seconds = time.perf_counter() - start
    error = work.check(drape)
    if not error <= 1.5:
        raise ValueError(f"{cell} is wrong: the force left is {error:.2f} of what is allowed, in float64")
    with counting_compilations() as again:
        times = time_calls({"xla": lambda turn: work(turn).state.x}, config.repeats, config.cell_seconds)["xla"]
    found = summary(times, 1, None)
    taken = {"solver_steps": int(drape.report.steps), "linear_iterations": int(drape.report.iterations)}
    compiled = {"compile_s": compiling.seconds, "compilations": compiling.count, "first_s": seconds}
    found |= {"error": error, "unit": "of the tolerance", "compilations_afterwards": again.count, "beside": {}}
    return found | taken | compiled | joules(lambda turn: work(turn).state.x, found)


def measure_preparation(cell: Cell, config: Config) -> dict[str, Any]:
    """Pattern, mesh and graph of a garment of the working density, from the design; a new topology each time."""
    model, space = load_pretrained(), load_design_space()
    name = min(PREPARED, key=lambda design: abs(PREPARED[design] / cell.vertices - 1))
    if abs(PREPARED[name] / cell.vertices - 1) > 0.2:
        return {"skipped": "no garment of the working density has this size"}
    made = prepare(model, space.preset(name))
    with counting_compilations() as compiling:
        calls = {"xla": lambda turn: prepare(model, space.preset(name), seed=1 + turn).mean_vertices}
        times = time_calls(calls, config.repeats, config.cell_seconds)["xla"]
    checked = {"error": 0.0, "unit": "", "compile_s": compiling.seconds, "compilations": compiling.count, "beside": {}}
    return summary(times, 1, None) | checked | {"compilations_afterwards": 0, "prepared_vertices": made.num_vertices}


def summary(times: Sequence[float], samples: int, floor: float | None) -> dict[str, Any]:
    """Median, quartiles and every run in milliseconds, throughput, share of the ceiling."""
    low, middle, high = (1e3 * float(x) for x in np.quantile(times, [0.25, 0.5, 0.75]))
    found = {"ms": middle, "lower_ms": low, "upper_ms": high, "runs_ms": [1e3 * t for t in times]}
    found["per_second"] = 1e3 * samples / middle
    if floor is not None:
        found["share_of_ceiling"] = 1e3 * floor / middle
    return found


def joules(call: Callable[[int], Any], entry: dict[str, Any]) -> dict[str, float]:
    """Energy of one call over a second of them, where the machine tells."""
    meter = EnergyMeter()
    count = max(3, int(1000 / entry["ms"]))
    if meter.read is None and jax.devices()[0].platform == "cpu":
        return {}
    with meter.running():
        for turn in range(count):
            jax.block_until_ready(call(turn))
    return {} if meter.joules is None else {"joules": meter.joules / count}


def peak_megabytes(made: Any) -> float | None:
    """Memory of arguments, results and everything between, as XLA planned it, 10⁶ bytes."""
    analysis = made.memory_analysis()
    if analysis is None:
        return None
    peak = getattr(analysis, "peak_memory_in_bytes", 0)
    parts = analysis.temp_size_in_bytes + analysis.argument_size_in_bytes + analysis.output_size_in_bytes
    return max(peak, parts) / 1e6


def run(config: Config, path: Path) -> dict[str, Any]:
    """Measure all cells that are not settled; the record, which is kept at `path` from cell to cell."""
    began = time.monotonic()
    before = surroundings()
    options = asdict(config) | {"out": ""}
    record = read_begun(path, options, before) if config.resume else None
    on_cpu = jax.devices()[0].platform == "cpu"
    size, megabytes = (1536, 400) if on_cpu else (8192, 2000)
    ceilings = measure_ceilings(512 if config.quick else size, 64 if config.quick else megabytes)
    cells = plan(config)
    piece: dict[str, Any] = {
        **{name: before[name] for name in ("date", "load_average", "clocks_mhz")},
        "ceilings": {
            "dense_gflops": ceilings.dense,
            "bandwidth_gb_s": ceilings.bandwidth,
            "bandwidth_gb_s_by_mb": ceilings.by_megabytes,
        },
    }
    if record is None:
        record = {
            "benchmark": "compare",
            "environment": before,
            "minutes": 0.0,
            "config": options,
            "ceilings": piece["ceilings"],
            "versions_of_peers": peer_versions(),
            "pieces": [],
            "cells": [],
        }
    earlier = {Cell(**{f.name: entry[f.name] for f in fields(Cell)}): entry for entry in record["cells"]}
    record["cells"] = entries = [earlier.get(cell, asdict(cell) | cut_off(config.minutes)) for cell in cells]
    minutes_before = record["minutes"]
    open_cells = [k for k, entry in enumerate(entries) if not measured(entry, options)]
    if open_cells:
        record.setdefault("pieces", []).append(piece)
        record["config"] |= {name: options[name] for name in LIMITS}
    failures: list[str] = []
    for k in tqdm(open_cells, desc="cells", mininterval=2):
        late = time.monotonic() - began > 60 * config.minutes
        if late:
            entries[k] = asdict(cells[k]) | cut_off(config.minutes)
        else:
            start = time.perf_counter()
            try:
                entries[k] = measure_cell(cells[k], config, ceilings)
            except (ValueError, RuntimeError) as error:
                # One cell that is wrong, or out of memory, must not cost the others; the command fails at its end.
                entries[k] = asdict(cells[k]) | failed(error)
                failures.append(f"{cells[k]}: {error}")
            entries[k]["took_s"] = round(time.perf_counter() - start, 2)
        piece["minutes"] = round((time.monotonic() - began) / 60, 2)
        piece["load_average_after"] = record["load_average_after"] = surroundings()["load_average"]
        record["minutes"] = round(minutes_before + piece["minutes"], 2)
        stats = jax.devices()[0].memory_stats() or {}
        record["device_peak_mb"] = stats.get("peak_bytes_in_use", 0) / 1e6 or None
        write_text(path, json.dumps(record, indent=1, default=plain) + "\n")
    if failures:
        raise RuntimeError(f"{len(failures)} cells failed, the first: {failures[0]}")
    return record


def peer_versions() -> dict[str, str]:
    """Versions of the peers that are installed."""
    import importlib.metadata

    found = {}
    for name in ("torch", "torch_geometric", "scipy"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def main(config: Config) -> None:
    """Measure, write the record, say what was slow and what was skipped."""
    path = config.out / f"{slug(surroundings()['device'])}.json"
    record = run(config, path)
    timed = [entry for entry in record["cells"] if "ms" in entry]
    for entry in timed:
        cell = " ".join(str(entry[k]) for k in ("subject", "config", "vertices", "batch", "precision"))
        share = f", {100 * entry['share_of_ceiling']:.0f} % of the ceiling" if "share_of_ceiling" in entry else ""
        peers = "".join(f", {name} {statistics.median(t):.3g} ms" for name, t in entry["beside"].items())
        print(f"{cell}: {entry['ms']:.3g} ms{share}{peers}")
    print(f"{len(timed)} cells timed, {len(record['cells']) - len(timed)} skipped; wrote {path}")
