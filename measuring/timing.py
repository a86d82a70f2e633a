"""Take times that mean what they say."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np


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


def milliseconds(call: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """Median wall-clock and median processor time of work on the host.

    Args:
        call: what is timed.
        repeats: calls that are timed.
    """
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        call()
        walls.append(1e3 * (time.perf_counter() - wall))
        cpus.append(1e3 * (time.process_time() - cpu))
    return float(np.median(walls)), float(np.median(cpus))
