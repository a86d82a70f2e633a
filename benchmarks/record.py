"""Take times that mean what they say, and keep them with the hardware and versions they were measured on."""

import dataclasses
import datetime
import importlib.metadata
import json
import os
import platform
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

import tryon_jax
from tryon_jax.files.atomic import write_text

RESULTS = Path(__file__).parent / "results"
"""Where results are kept, one file for each benchmark and device."""


@dataclass(frozen=True)
class Timing:
    """Wall-clock seconds of one call."""

    first: float
    """Of the first call, which compiles."""
    median: float
    lower_quartile: float
    upper_quartile: float
    repeats: int

    def __str__(self) -> str:
        """Median and interquartile range in milliseconds."""
        low, high = 1e3 * self.lower_quartile, 1e3 * self.upper_quartile
        return f"{1e3 * self.median:.3g} ms ({low:.3g} to {high:.3g})"


def measure(
    function: Callable[..., Any],
    *arguments: Any,
    repeats: int = 30,
    warmup: int = 2,
    max_seconds: float = 20.0,
) -> Timing:
    """Time `function(*arguments)` until its device work is done.

    Args:
        function: what is timed; its result may be any pytree.
        arguments: handed over as they are; put them on the device before.
        repeats: calls that are timed.
        warmup: calls after the first that are not.
        max_seconds: stop early after this time, with 3 timed calls at least.
    """
    start = time.perf_counter()
    jax.block_until_ready(function(*arguments))
    first = time.perf_counter() - start
    for _ in range(warmup):
        jax.block_until_ready(function(*arguments))
    times = []
    begin = time.perf_counter()
    while len(times) < repeats and (len(times) < 3 or time.perf_counter() - begin < max_seconds):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - start)
    low, middle, high = np.quantile(times, [0.25, 0.5, 0.75])
    return Timing(first, float(middle), float(low), float(high), len(times))


def environment() -> dict[str, Any]:
    """Hardware, versions and date of this run."""
    device = jax.devices()[0]
    packages = ("jax", "jaxlib", "numpy", "scipy", "optax", "optimistix")
    return {
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
        "device": device.device_kind if device.platform != "cpu" else _cpu_name(),
        "platform": device.platform,
        "cpu": _cpu_name(),
        "cpu_cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "python": platform.python_version(),
        "tryon_jax": tryon_jax.__version__,
        **{name: importlib.metadata.version(name) for name in packages},
        **({"xla_flags": os.environ["XLA_FLAGS"]} if os.environ.get("XLA_FLAGS") else {}),
    }


def _cpu_name() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        text = ""
    match = re.search(r"model name\s*:\s*(.+)", text)
    return match[1].strip() if match else platform.processor() or platform.machine()


def write_record(
    name: str, config: Any, rows: Sequence[Mapping[str, Any]], *, folder: Path | None = None, note: str = ""
) -> Path:
    """Write `rows` of results to `<folder>/<name>-<device>.json` and return the path.

    Args:
        name: the benchmark.
        config: its dataclass of options.
        rows: one mapping for each line of its table; `Timing`s become their fields.
        folder: where to, `benchmarks/results` by default.
        note: what a reader has to know to read the numbers.
    """
    surroundings = environment()
    record = {
        "benchmark": name,
        "note": note,
        "environment": surroundings,
        "config": dataclasses.asdict(config),
        "rows": [
            {key: dataclasses.asdict(value) if isinstance(value, Timing) else value for key, value in row.items()}
            for row in rows
        ],
    }
    device = re.sub(r"[^a-z0-9]+", "-", surroundings["device"].lower()).strip("-")
    path = (RESULTS if folder is None else folder) / f"{name}-{device}.json"
    write_text(path, json.dumps(record, indent=2, default=_plain) + "\n")
    return path


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray | jax.Array):
        return np.asarray(value).tolist()
    return str(value)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as a Markdown table; all have the first one's columns."""
    columns = list(rows[0])
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    for row in rows:
        cells = [f"{row[c]:.4g}" if isinstance(row[c], float) else str(row[c]) for c in columns]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
