"""What the first drape of a new process costs: the command line from its start to its files.

python -m benchmarks first
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.record import write_record
from measuring.records import table
from tryon_jax.files.compile_cache import VARIABLE

COMMANDS = {
    "mesh": ("--out", "{folder}/dress.glb"),
    "mesh and picture, T-pose": ("--out", "{folder}/dress.glb", "--picture", "{folder}/dress.png", "--arms", "0"),
    "mesh and picture, arms down": ("--out", "{folder}/dress.glb", "--picture", "{folder}/dress.png"),
}
"""Options of each row, beside the garment and the body."""
GARMENT = ("--design", "dress", "--betas", "1.5", "-0.5")


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks first`."""

    repeats: int = 3
    """Processes of each row."""
    kept: bool = True
    """Measure too with compiled programs kept from an earlier run (`TRYON_JAX_CACHE`)."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def main(config: Config) -> None:
    """Measure, print the table, and keep it."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, options in COMMANDS.items():
            words = [word.format(folder=folder) for word in (*GARMENT, *options)]
            for cache in ("", str(Path(folder) / "programs"))[: 1 + config.kept]:
                if cache:
                    run(words, cache)
                rows.append(
                    {"files": name, "compiled programs": "kept" if cache else "none"} | measure(words, cache, config)
                )
    print(table(rows))
    if config.save:
        print(f"wrote {write_record('first', config, rows, note='medians of new processes')}")


def measure(words: Sequence[str], cache: str, config: Config) -> dict[str, Any]:
    """Medians of some processes, seconds.

    Args:
        words: Options of `tryon drape`.
        cache: Folder for compiled programs; empty for none.
        config: How often.
    """
    found = [run(words, cache) for _ in range(config.repeats)]
    return {
        "wall, s": round(median(wall for wall, _ in found), 2),
        "processor, s": round(median(cpu for _, cpu in found), 2),
    }


def run(words: Sequence[str], cache: str) -> tuple[float, float]:
    """One process: seconds on the clock, and of processors.

    Args:
        words: Options of `tryon drape`.
        cache: Folder for compiled programs; empty for none.

    Raises:
        CalledProcessError: it failed.
    """
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", VARIABLE: cache}
    before, start = _used(), time.perf_counter()
    command = [sys.executable, "-m", "tryon_jax", "drape", *words]
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - start, _used() - before


def _used() -> float:
    """Processor seconds of all processes that this one has waited for."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
