"""Where the time of one subject of the comparison goes: the device's kernels by the time they take, and its idle share.

python -m benchmarks profile
python -m benchmarks profile --subject "solver step" --batch 64 --top 20
"""

import tempfile
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
from jax.profiler import ProfileData

from benchmarks import _simulation
from benchmarks._subjects import Cell
from benchmarks.compare import SUBJECTS, Compiled
from measuring.records import table
from tryon_jax.checks import check_choice


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks profile`."""

    subject: str = "drape"
    """One of the comparison's, or "full equilibrium"."""
    config: str = "small"
    """Size of the networks."""
    vertices: int = 3581
    """Size of the garment."""
    batch: int = 8
    """Body shapes in one call."""
    calls: int = 5
    """Calls that are recorded."""
    top: int = 12
    """Kernels that are listed."""


def device_events(data: Any) -> Iterable[tuple[str, float]]:
    """Name and nanoseconds of what ran on the device, from a `ProfileData`.

    On a GPU these are the kernels of its streams, on a CPU the operations of XLA.
    """
    planes = list(data.planes)
    cards = [plane for plane in planes if plane.name.startswith("/device:GPU")]
    for plane in cards or [plane for plane in planes if plane.name == "/host:CPU"]:
        for line in plane.lines:
            if cards and not line.name.startswith("Stream"):
                continue
            for event in line.events:
                # On a CPU, the runtime's own events stand beside the operations, which alone name their module.
                if cards or any(name == "hlo_op" for name, _ in event.stats):
                    yield event.name, float(event.duration_ns)


def record(call: Callable[[int], Any], calls: int) -> tuple[float, dict[str, list[float]]]:
    """Seconds of the calls on the clock, and the nanoseconds of every run of each kernel."""
    jax.block_until_ready(call(0))
    # Python's own calls are not asked for: to trace them costs time.
    options = jax.profiler.ProfileOptions()
    options.python_tracer_level = 0
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder, profiler_options=options):
            start = time.perf_counter()
            for turn in range(calls):
                jax.block_until_ready(call(turn))
            seconds = time.perf_counter() - start
        [file] = Path(folder).rglob("*.xplane.pb")
        found: dict[str, list[float]] = defaultdict(list)
        with warnings.catch_warnings():
            # JAX's types of a profile lack a module, of which Python 3.13 warns; where warnings are errors, JAX aborts.
            warnings.simplefilter("ignore", DeprecationWarning)
            for name, duration in device_events(ProfileData.from_file(str(file))):
                found[name].append(duration)
    return seconds, dict(found)


def rows_of(config: Config, seconds: float, kernels: dict[str, list[float]]) -> list[dict[str, Any]]:
    """One row for each of the costliest kernels; times are of one call."""
    order = sorted(kernels, key=lambda name: -sum(kernels[name]))
    return [
        {
            "kernel": name[:72],
            "runs": len(kernels[name]) / config.calls,
            "ms": 1e-6 * sum(kernels[name]) / config.calls,
            "share, %": 1e-7 * sum(kernels[name]) / seconds,
        }
        for name in order[: config.top]
    ]


def main(config: Config) -> None:
    """Compile, record, print."""
    check_choice("subject", config.subject, (*SUBJECTS, "full equilibrium"))
    named = config.config if config.subject not in ("collision loss", "solver step", "full equilibrium") else ""
    cell = Cell(config.subject, named, config.vertices, config.batch)
    if config.subject == "full equilibrium":
        work = _simulation.FullEquilibrium(cell)

        def call(turn: int) -> Any:
            return work(turn).state.x
    else:
        call = Compiled(SUBJECTS[config.subject](cell)).fresh
    seconds, kernels = record(call, config.calls)
    busy = 1e-9 * sum(map(sum, kernels.values()))
    runs = sum(map(len, kernels.values())) / config.calls
    print(table(rows_of(config, seconds, kernels)))
    print(
        f"\n{config.subject} {named} {config.vertices} x {config.batch} on {jax.devices()[0].device_kind}: "
        f"{1e3 * seconds / config.calls:.3g} ms a call under the profiler, {runs:.0f} kernels, "
        f"which take {100 * busy / seconds:.0f} % of it"
    )
