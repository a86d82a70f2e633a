"""All that a GPU is needed for in one short run: check, throughput, simulator, training, each in its share of time.

python -m benchmarks gpu --minutes 9 --out FOLDER
python -m benchmarks gpu --minutes 9 --out FOLDER --data PACKED      (a data set made by `experiments pack`)

The same command again, on any card, goes on: a card's own record is continued, another card begins its own, training
continues from its last checkpoint, and what was compiled once is not compiled again. The record is written after every
cell.
"""

import os
import time
from collections.abc import Callable, MutableMapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import jax

from benchmarks import compare, profile
from benchmarks._comparison import Comparison
from benchmarks._gpu_training import Training, check_data, train
from benchmarks._machine import Ceilings, surroundings
from benchmarks._plan import simulator_cells, throughput_cells
from benchmarks._simulation import SideBySide
from benchmarks._subjects import Cell
from benchmarks.float64 import check_drape
from benchmarks.record import RESULTS
from benchmarks.report import load_records
from measuring.records import slug
from tryon_jax.checks import check_range
from tryon_jax.files.compile_cache import keep_in

NO_TRITON = "--xla_gpu_enable_triton_gemm=false"
"""XLA tries Triton's matrix products one by one while it compiles: ten times the time, for nothing at run time."""
CPUS = 16
"""Drapes side by side are profiled where so many CPUs would make them faster."""


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks gpu`."""

    out: Path
    """Folder of everything: record, compiled functions, training run. It travels from run to run."""
    minutes: float = 9.0
    """Time for this run, measured from its start; a cell that is being measured then is finished."""
    data: Path | None = None
    """Folder of the data set that is trained on, full or packed; without it nothing is trained."""
    check_share: float = 0.08
    """Share of the time for the check; what one part leaves, the next ones have."""
    throughput_share: float = 0.47
    simulator_share: float = 0.2
    """Training has what is left of the time."""
    configs: tuple[str, ...] = ("small", "paper")
    """Sizes of the networks."""
    vertices: tuple[int, ...] = (1414, 3581, 14_000, 100_000)
    """Sizes of the garment."""
    batches: tuple[int, ...] = (1, 64, 4096)
    """Body shapes in one call."""
    at_vertices: int = 3581
    """Size that is measured first, and that drapes are simulated at."""
    at_batch: int = 64
    """Batch that is measured first."""
    lanes: tuple[int, ...] = (1, 16, 64, 256)
    """Drapes that are simulated side by side."""
    repeats: int = 15
    """Timed calls of each cell."""
    cell_seconds: float = 0.7
    """Longest time for the timed calls of one cell, with three of each at least."""
    max_call_seconds: float = 1.5
    """Cells whose one call would take longer, as predicted from the measured ceilings, are skipped."""
    max_lanes_seconds: float = 20.0
    """Drapes side by side that would take longer together, by their first steps, are not made."""
    quick: bool = False
    """Ceilings from small arrays: to see on a CPU that all works."""
    training: Training = field(default_factory=Training)
    """How the networks are trained."""


@dataclass(frozen=True, eq=False)
class Steps:
    """What a run does and the clock that it goes by; tests put their own in place."""

    clock: Callable[[], float] = time.monotonic
    check: Callable[[], dict[str, Any]] = check_drape
    measure: Callable[[Cell, compare.Config, Ceilings], dict[str, Any]] = compare.measure_cell
    train: Callable[[Path, Path, Training, float], dict[str, Any]] = train


def set_flags(environment: MutableMapping[str, str], card: bool) -> None:
    """Tell XLA, before JAX starts it, not to try Triton's matrix products; nothing where there is no card."""
    asked = environment.get("XLA_FLAGS", "")
    if card and "xla_gpu_enable_triton_gemm" not in asked:
        environment["XLA_FLAGS"] = f"{asked} {NO_TRITON}".strip()


def has_card(environment: MutableMapping[str, str]) -> bool:
    """Whether JAX will find an NVIDIA card, as told by the driver: to ask JAX would start it."""
    allowed = environment.get("JAX_PLATFORMS", "cuda")
    return Path("/proc/driver/nvidia/version").exists() and any(name in allowed for name in ("cuda", "gpu"))


def keep_compiled(folder: Path) -> None:
    """Let JAX keep what it compiles in `folder` and find it there again."""
    folder.mkdir(parents=True, exist_ok=True)
    keep_in(folder)


def limits_of(config: Config) -> compare.Config:
    """The options as the comparison's cells take them."""
    stats = jax.devices()[0].memory_stats() or {}
    return compare.Config(
        configs=config.configs,
        vertices=config.vertices,
        batches=config.batches,
        at_vertices=config.at_vertices,
        at_batch=config.at_batch,
        minutes=config.minutes,
        resume=True,
        max_call_seconds=config.max_call_seconds,
        max_lanes_seconds=config.max_lanes_seconds,
        max_gigabytes=0.75e-9 * stats.get("bytes_limit", 8e9),
        repeats=config.repeats,
        cell_seconds=config.cell_seconds,
        quick=config.quick,
        peers=False,
    )


def run(config: Config, steps: Steps) -> dict[str, Any]:
    """The four parts, in their order; the record.

    Raises:
        ValueError: the record is of other versions or options, or the check failed; then nothing is measured.
        RuntimeError: single cells failed, after all else was done.
    """
    if config.data is not None:
        check_data(config.data, config.out / "run")
    limits = limits_of(config)
    path = config.out / f"gpu-{slug(surroundings()['device'])}.json"
    sizes = config.at_vertices, config.at_batch
    throughput = throughput_cells(config.configs, config.vertices, config.batches, *sizes)
    simulator = simulator_cells(config.at_vertices, config.lanes)
    comparison = Comparison(path, asdict(limits), [*throughput, *simulator], config.minutes, True, steps.clock)
    began, seconds = comparison.began, 60 * config.minutes
    parts: dict[str, float] = {}
    comparison.piece["parts_s"] = parts

    def done(name: str) -> None:
        parts[name] = round(steps.clock() - began - sum(parts.values()), 2)
        comparison.write()

    comparison.record["check"] = steps.check()
    done("check")
    ceilings = comparison.measure_ceilings(*((512, 64) if config.quick else compare.ceiling_sizes()))

    def measure(cell: Cell) -> dict[str, Any]:
        return steps.measure(cell, limits, ceilings)

    share = config.check_share + config.throughput_share
    comparison.measure(throughput, measure, began + share * seconds, must_fit=True, title="throughput")
    done("throughput")
    share += config.simulator_share
    for cell in simulator:
        comparison.measure([cell], measure, began + share * seconds, must_fit=True, title=cell.subject)
        entry = comparison.entry(cell)
        late = steps.clock() > began + share * seconds
        if cell.subject == "side by side" and not late and is_slow(entry) and not _profiled(comparison.record):
            comparison.settle(cell, entry | {"profile": profile_of(cell, entry.get("round_steps"))})
    done("simulator")
    if config.data is not None:
        left = began + seconds - steps.clock()
        comparison.record["training"] = steps.train(config.data, config.out / "run", config.training, left)
        done("training")
    comparison.raise_failures()
    return comparison.record


def cpu_seconds(vertices: int) -> float | None:
    """Seconds that one CPU takes for a drape of this size, by the fastest record of a comparison on one."""
    times = [
        1e-3 * cell["ms"]
        for record in load_records(RESULTS)
        for cell in record["cells"]
        if record["environment"]["platform"] == "cpu" and "ms" in cell
        if (cell["subject"], cell["vertices"]) == ("full equilibrium", vertices)
    ]
    return min(times, default=None)


def is_slow(entry: dict[str, Any]) -> bool:
    """Whether drapes side by side take longer each than 16 CPUs would need, or are too slow to be made at all."""
    if "max_lanes_seconds" in entry.get("needs", {}):
        return True
    cpu = cpu_seconds(entry["vertices"])
    return "ms" in entry and cpu is not None and 1.0 / entry["per_second"] > cpu / CPUS


def _profiled(record: dict[str, Any]) -> bool:
    return any("profile" in entry for entry in record["cells"])


def profile_of(cell: Cell, steps: int | None) -> dict[str, Any]:
    """Kernels by the time they take, of one round of steps."""
    work = SideBySide(cell)
    seconds, kernels = profile.record(lambda turn: [d.state.x for d in work.drapes(turn, steps)], 1)
    busy = 1e-9 * sum(map(sum, kernels.values()))
    rows = profile.rows_of(profile.Config(calls=1, top=20), seconds, kernels)
    return {"seconds": seconds, "busy_share": busy / seconds, "kernels": sum(map(len, kernels.values())), "rows": rows}


def said(record: dict[str, Any]) -> list[str]:
    """What a run says at its end."""
    timed = [entry for entry in record["cells"] if "ms" in entry]
    lines = [f"check: {record['check']['error_mm']:.2g} mm from float64"]
    for entry in timed:
        cell = " ".join(str(entry[k]) for k in ("subject", "config", "vertices", "batch", "precision") if entry[k])
        known = f", {entry['from_cache']} of {entry['compilations']} from before" if entry.get("from_cache") else ""
        rate = f"{entry['ms']:.3g} ms, {entry['per_second']:.3g}/s"
        lines.append(f"{cell}: {rate}, compiled in {entry['compile_s']:.1f} s{known}")
    lines.append(f"{len(timed)} of {len(record['cells'])} cells timed")
    training = record.get("training")
    if training:
        lines += [f"training: {training['state']}", *training["compared"]]
    return lines


def main(config: Config) -> None:
    """Measure and train for so many minutes, and say what came of it."""
    check_range("minutes", config.minutes, 0.01, 600.0)
    shares = config.check_share, config.throughput_share, config.simulator_share
    for name, share in zip(("check_share", "throughput_share", "simulator_share"), shares, strict=True):
        check_range(name, share, 0.0, 1.0)
    if sum(shares) > 1:
        raise ValueError(f"check_share, throughput_share and simulator_share add up to {sum(shares):g}, more than 1")
    card = has_card(os.environ)
    set_flags(os.environ, card)
    if card:
        # What was compiled for one CPU may not run on another.
        keep_compiled(config.out / "compiled")
    record = run(config, Steps())
    print("\n".join(said(record)))
    print(f"wrote {config.out}; the same command continues")
