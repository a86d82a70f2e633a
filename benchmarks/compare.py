"""XLA on this device: one record that `python -m benchmarks report` sets beside those of other devices.

python -m benchmarks compare
python -m benchmarks compare --quick
python -m benchmarks compare --full --minutes 60
python -m benchmarks compare --full --minutes 60 --resume

The record is written after every cell, so that nothing measured is lost when it is stopped.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks import _fields, _simulation, _subjects
from benchmarks._calls import Compiled, joules, peak_megabytes, summary, time_calls
from benchmarks._comparison import Comparison
from benchmarks._garments import garment_of
from benchmarks._machine import PRECISIONS, Ceilings, counting_compilations, supported, surroundings
from benchmarks._networks import dense_floor
from benchmarks._pieces import too_large, too_long
from benchmarks._subjects import Cell, Work, config_of, tryon_model
from benchmarks.record import RESULTS
from measuring.records import slug
from tryon_jax.checks import check_choice
from tryon_jax.garment import load_design_space
from tryon_jax.tryon import load_pretrained, prepare

SUBJECTS: dict[str, Callable[[Cell], Work]] = {
    "Laplacian product": _subjects.laplacian_product,
    "Chebyshev layer": _subjects.cheb_layer,
    "U-Net forward": _subjects.unet_forward,
    "U-Net gradient": _subjects.unet_gradient,
    "drape with fields": _fields.drape_with_fields,
    "drape": _subjects.whole_drape,
    "training step": _subjects.training_step,
    "collision loss": _simulation.collision,
    "solver step": _simulation.solver_step,
}
"""What is compiled as one function; the full equilibrium and the preparation of a garment run on the host."""
NETWORKS = (
    "Laplacian product",
    "Chebyshev layer",
    "U-Net forward",
    "U-Net gradient",
    "drape with fields",
    "drape",
    "training step",
)
ALONE = ("full equilibrium", "push-out", "prepare")
"""Subjects that treat one drape at a time."""
ALL = (*SUBJECTS, "side by side", *ALONE)
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
    max_lanes_seconds: float = 20.0
    """Drapes side by side that would take longer together, by their first steps, are not made."""
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
                if subject in ALONE:
                    b = 1
                rounds.setdefault(Cell(subject, name, v, b), turn)
                if subject in ("drape with fields", "drape", "U-Net forward") and (config.full or (v, b) == middle):
                    for precision in PRECISIONS if subject != "drape with fields" else ("float32", "tf32"):
                        rounds.setdefault(Cell(subject, name, v, b, precision), turn)
    return sorted(rounds, key=lambda cell: rounds[cell])


def needed_gigabytes(cell: Cell) -> float:
    """Memory that a cell's activations need, roughly and rather too much."""
    if cell.subject not in NETWORKS:
        width = 3 * _simulation.LIST_LENGTH if cell.subject == "collision loss" else 12 * 40
    else:
        widths = config_of(cell).smooth.widths
        keep = "gradient" in cell.subject or "training" in cell.subject
        width = {
            "Laplacian product": 2 * widths[0],
            "Chebyshev layer": 5 * _subjects.LAYER_WIDTH[cell.config],
            "drape with fields": 12 + 8 * widths[0] / cell.batch,
        }.get(cell.subject, 8 * widths[0] * (3 if keep else 1))
    return 4e-9 * cell.vertices * 1.1 * cell.batch * width


def measure_cell(cell: Cell, config: Config, ceilings: Ceilings) -> dict[str, Any]:
    """Compile, check, time; one entry of the record."""
    entry: dict[str, Any] = asdict(cell)
    if not supported(cell.precision):
        return entry | {"skipped": f"the device has no {cell.precision}"}
    if cell.subject == "prepare":
        return entry | measure_preparation(cell, config)
    if cell.subject == "push-out":
        return entry | measure_push_out(cell, config)
    gigabytes = needed_gigabytes(cell)
    if gigabytes > config.max_gigabytes:
        return entry | too_large(gigabytes)
    if cell.subject == "full equilibrium":
        return entry | measure_equilibrium(cell, config, ceilings)
    if cell.subject == "side by side":
        return entry | measure_side_by_side(cell, config, ceilings)
    work = SUBJECTS[cell.subject](cell)
    predicted = 3 * ceilings.floor(work.flops, work.moved, cell.precision)
    if predicted > config.max_call_seconds:
        return entry | too_long(predicted, predicted)
    with counting_compilations() as compiling:
        start = time.perf_counter()
        with jax.default_matmul_precision(PRECISIONS[cell.precision][1]):
            made = Compiled(work)
        seconds = time.perf_counter() - start
    entry |= {"compile_s": seconds, "compilations": compiling.count, "from_cache": compiling.from_cache}
    entry |= {"error": work.check(made), "unit": work.unit}
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


def equilibrium_seconds(cell: Cell, ceilings: Ceilings) -> float:
    """Three times what moving the solver's matrices takes."""
    rows, slots = cell.vertices * 1.1, 12
    return 3 * _simulation.CG_ITERATIONS * 30 * 1e-9 * rows * slots * 40 * cell.batch / ceilings.bandwidth


def measure_equilibrium(cell: Cell, config: Config, ceilings: Ceilings) -> dict[str, Any]:
    """The same for the host's loop around the compiled solver."""
    predicted = equilibrium_seconds(cell, ceilings)
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


def measure_side_by_side(cell: Cell, config: Config, ceilings: Ceilings) -> dict[str, Any]:
    """The same in lanes of one mapped solve, a round of steps before the whole: what compiles is apart from what runs.

    A whole drape is not begun where the round says that it would take too long.
    """
    predicted = equilibrium_seconds(cell, ceilings)
    if predicted > config.max_call_seconds * 2:
        return too_long(predicted, predicted / 2)
    work = _simulation.SideBySide(cell)
    refresh = work.equilibrium.refresh
    with counting_compilations() as compiling:
        start = time.perf_counter()
        work.drapes(0, refresh)
        first = time.perf_counter() - start
    start = time.perf_counter()
    work.drapes(1, refresh)
    one_round = time.perf_counter() - start
    found: dict[str, Any] = {"compile_s": compiling.seconds, "compilations": compiling.count}
    found |= {"from_cache": compiling.from_cache, "first_s": first, "round_s": one_round, "round_steps": refresh}
    longest = one_round * work.equilibrium.max_steps / refresh
    if longest > config.max_lanes_seconds:
        return found | {
            "skipped": f"drapes would take up to {longest:.1f} s: {refresh} steps took {one_round:.1f} s",
            "needs": {"max_lanes_seconds": longest},
        }
    drapes = work.drapes(0)
    error = max(work.check(drape) for drape in (drapes[0], drapes[-1]))
    if not error <= 1.5:
        raise ValueError(f"{cell} is wrong: the force left is {error:.2f} of what is allowed, in float64")
    with counting_compilations() as again:
        calls = {"xla": lambda turn: [drape.state.x for drape in work.drapes(turn)]}
        times = time_calls(calls, config.repeats, config.cell_seconds)["xla"]
    found |= summary(times, cell.batch, None)
    found |= {"error": error, "unit": "of the tolerance", "compilations_afterwards": again.count, "beside": {}}
    found["solver_steps"] = max(int(drape.report.steps) for drape in drapes)
    found["linear_iterations"] = max(int(drape.report.iterations) for drape in drapes)
    return found | joules(calls["xla"], found)


def measure_push_out(cell: Cell, config: Config) -> dict[str, Any]:
    """The push-out of one drape, which is checked by the distances that it measures in float64."""
    work = _simulation.PushOut(cell)
    pushed = [work(turn) for turn in range(_subjects.FRESH)]
    inside = max(drape.inside for drape in pushed)
    if inside:
        raise ValueError(f"{cell} is wrong: {100 * inside:.2f} % of the samples are inside the body")
    times = time_calls({"xla": lambda turn: work(turn).vertices}, config.repeats, config.cell_seconds)["xla"]
    found = {"error": inside, "unit": "inside", "compile_s": 0.0, "compilations": 0, "compilations_afterwards": 0}
    found |= {"beside": {}, "rounds": max(drape.rounds for drape in pushed)}
    return summary(times, 1, None) | found


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


def run(config: Config, path: Path) -> dict[str, Any]:
    """Measure all cells that are not settled; the record, which is kept at `path` from cell to cell."""
    cells = plan(config)
    comparison = Comparison(path, asdict(config), cells, config.minutes, config.resume)
    size, megabytes = (512, 64) if config.quick else ceiling_sizes()
    ceilings = comparison.measure_ceilings(size, megabytes)
    until = comparison.began + 60 * config.minutes
    comparison.measure(cells, lambda cell: measure_cell(cell, config, ceilings), until)
    comparison.raise_failures()
    return comparison.record


def ceiling_sizes() -> tuple[int, int]:
    """Rows of the matrices, and megabytes of the arrays, that the ceilings of this device are measured with."""
    return (1536, 400) if jax.devices()[0].platform == "cpu" else (8192, 2000)


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
