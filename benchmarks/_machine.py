"""Highest speeds of a machine, and its state while it is measured."""

import functools
import itertools
import os
import re
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from measuring.records import environment

_COMPILED = "/jax/core/compile/backend_compile_duration"
_FROM_CACHE = "/jax/compilation_cache/cache_hits"
_POWERCAP = Path("/sys/class/powercap")


@dataclass
class Compilations:
    """How often XLA compiled something since this was made, and for how long."""

    count: int = 0
    seconds: float = 0.0
    from_cache: int = 0
    """Of these, how many JAX's cache folder had already: their seconds are of reading alone."""


_listening: list[Compilations] = []


def _heard(event: str, duration_secs: float, **_: Any) -> None:
    if event == _COMPILED:
        for counter in _listening:
            counter.count += 1
            counter.seconds += duration_secs


def _heard_event(event: str, **_: Any) -> None:
    if event == _FROM_CACHE:
        for counter in _listening:
            counter.from_cache += 1


@functools.cache
def _listen() -> None:
    jax.monitoring.register_event_duration_secs_listener(_heard)
    jax.monitoring.register_event_listener(_heard_event)


@contextmanager
def counting_compilations() -> Iterator[Compilations]:
    """Count what XLA compiles inside the block."""
    _listen()
    counter = Compilations()
    _listening.append(counter)
    try:
        yield counter
    finally:
        _listening.remove(counter)


def surroundings() -> dict[str, Any]:
    """`environment()` with the machine's load, clocks, memory and, for NVIDIA cards, driver."""
    load = os.getloadavg() if hasattr(os, "getloadavg") else (float("nan"),) * 3
    found = environment() | {
        "load_average": [round(x, 2) for x in load],
        "clocks_mhz": clocks(),
        "devices": len(jax.devices()),
    }
    stats = jax.devices()[0].memory_stats() or {}
    if "bytes_limit" in stats:
        found["device_memory_mb"] = round(stats["bytes_limit"] / 1e6)
    card = nvidia("name,driver_version,clocks.sm,clocks.mem,power.limit")
    if card:
        found["nvidia-smi"] = card
    return found


def clocks() -> list[float]:
    """Clock of each CPU core as found now, MHz; empty where the system does not tell."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return []
    return [float(x) for x in re.findall(r"cpu MHz\s*:\s*([\d.]+)", text)]


def nvidia(query: str) -> str:
    """One line of `nvidia-smi --query-gpu`, or "" where there is no such card."""
    if jax.devices()[0].platform != "gpu":
        return ""
    command = ["nvidia-smi", f"--query-gpu={query}", "--format=csv,noheader,nounits", "--id=0"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


@dataclass
class EnergyMeter:
    """Joules that the device (the card, or all CPU packages) took in a block; None where the machine does not tell."""

    joules: float | None = None
    read: Callable[[], float] | None = field(default_factory=lambda: energy_counter())

    @contextmanager
    def running(self) -> Iterator[None]:
        """Measure what is done inside the block."""
        if self.read is not None:
            before = self.read()
            yield
            self.joules = self.read() - before
        elif nvidia("power.draw"):
            with _sampled_power() as samples:
                yield
            self.joules = integrate_power(samples)
        else:
            yield


def energy_counter() -> Callable[[], float] | None:
    """A function that reads RAPL's counters in joules, or None where they may not be read (as in virtual machines)."""
    if jax.devices()[0].platform != "cpu":
        return None
    files = sorted(_POWERCAP.glob("intel-rapl:?/energy_uj"))
    try:
        for file in files:
            file.read_text()
    except OSError:
        return None
    return (lambda: sum(int(file.read_text()) for file in files) * 1e-6) if files else None


@contextmanager
def _sampled_power(interval: float = 0.1) -> Iterator[list[tuple[float, float]]]:
    samples: list[tuple[float, float]] = []
    over = threading.Event()

    def sample() -> None:
        while not over.is_set():
            text = nvidia("power.draw")
            if text:
                samples.append((time.perf_counter(), float(text)))
            over.wait(interval)

    thread = threading.Thread(target=sample, daemon=True)
    thread.start()
    try:
        yield samples
    finally:
        over.set()
        thread.join()


def integrate_power(samples: list[tuple[float, float]]) -> float | None:
    """Joules from (seconds, watts) by the trapezoidal rule; None for fewer than two samples."""
    if len(samples) < 2:
        return None
    pairs = itertools.pairwise(samples)
    return sum(0.5 * (t1 - t0) * (w0 + w1) for (t0, w0), (t1, w1) in pairs)


@dataclass(frozen=True)
class Ceilings:
    """What the device reaches in its two simplest tasks."""

    dense: dict[str, float]
    """10⁹ floating-point operations per second of one large matrix product, by precision."""
    bandwidth: float
    """10⁹ bytes per second, read and written, of y = x / 2 + z on arrays larger than the caches."""
    by_megabytes: dict[float, float] = field(default_factory=dict)
    """The same by the size of all arrays together, 10⁶ bytes: smaller ones fit in caches."""

    def memory_speed(self, megabytes: float | None = None) -> float:
        """10⁹ bytes per second for work on so many megabytes, between sizes that were measured; of memory when None."""
        if megabytes is None or not self.by_megabytes:
            return self.bandwidth
        sizes = sorted(self.by_megabytes)
        speeds = [self.by_megabytes[size] for size in sizes]
        return float(np.interp(np.log(max(megabytes, 1e-6)), np.log(sizes), speeds))

    def floor(self, flops: float, moved: float, precision: str = "float32", megabytes: float | None = None) -> float:
        """Seconds that work cannot take less than: its operations or its traffic, whichever takes longer.

        Args:
            flops: Floating-point operations.
            moved: Bytes of every operand read or written once.
            precision: Of the operations.
            megabytes: Size of all that the work touches, 10⁶ bytes; None for work that fits in no cache.
        """
        operations = 1e-9 * flops / self.dense.get(precision, self.dense["float32"])
        return max(operations, 1e-9 * moved / self.memory_speed(megabytes))


def measure_ceilings(size: int, megabytes: int, repeats: int = 7) -> Ceilings:
    """Measure both; `size` of the square matrices, `megabytes` of each array."""
    dense = {name: _dense_speed(size, name, repeats) for name in PRECISIONS if supported(name)}
    largest = 3.0 * megabytes
    sizes = [size for size in WORKING_SETS if size < largest] + [largest]
    by_megabytes = {size: _memory_speed(size, largest, repeats) for size in sizes}
    return Ceilings(dense, by_megabytes[largest], by_megabytes)


def _dense_speed(size: int, precision: str, repeats: int) -> float:
    """10⁹ floating-point operations per second of one product of square matrices."""
    dtype, algorithm = PRECISIONS[precision]
    x = jnp.ones((size, size), dtype)
    with jax.default_matmul_precision(algorithm):
        product = jax.jit(lambda a, b: a @ b).lower(x, x).compile()
    return 2e-9 * size**3 / _best(lambda: product(x, x), repeats)


WORKING_SETS = (0.75, 3.0, 12.0, 48.0, 96.0, 192.0, 384.0)
"""Sizes of x, y and z together at which the memory is measured, 10⁶ bytes."""


def _memory_speed(megabytes: float, traffic: float, repeats: int) -> float:
    """10⁹ bytes per second of y = x / 2 + z on arrays of so many megabytes, over and over for `traffic` megabytes."""
    x = jnp.ones(int(megabytes * 1e6 / 12), jnp.float32)
    z = x + 1.0
    # Small arrays many times in one call: starting a call would take longer than the work.
    rounds = max(1, round(traffic / megabytes))

    def triad(x: jax.Array, z: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, rounds, lambda _, y: 0.5 * y + z, x)

    made = jax.jit(triad).lower(x, z).compile()
    return 3e-9 * x.nbytes * rounds / _best(lambda: made(x, z), repeats)


PRECISIONS = {
    "float32": (jnp.float32, "float32"),
    "tf32": (jnp.float32, "tensorfloat32"),
    "bfloat16": (jnp.bfloat16, "default"),
}
"""Precisions by name: type of the arrays, and precision of the products."""


def supported(precision: str) -> bool:
    """Whether this device has the precision: TF32 is of GPUs alone."""
    return precision != "tf32" or jax.devices()[0].platform == "gpu"


def _best(call: Callable[[], Any], repeats: int) -> float:
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - start)
    return min(times)
