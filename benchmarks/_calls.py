"""How a cell of the comparison is compiled and timed: fresh inputs, turns, medians, energy, memory."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from benchmarks._machine import EnergyMeter
from benchmarks._subjects import Work


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
