"""Simulating the dataset: tasks that any number of processes may work on.

A task writes one file in one step and does nothing where the file exists, so work can stop at any moment, and be done
twice without harm.
"""

import functools
from collections.abc import Sequence
from pathlib import Path

from tryon_jax.training.plan import Task
from tryon_jax.training.simulator import Simulator


def run_batch(root: str, tasks: Sequence[Task]) -> str:
    """Do those tasks of one kind whose files are missing, side by side where there are several (see `plan.batches`).

    Returns a line for the log ("" when there was nothing to do).
    """
    folder = Path(root)
    missing = [task for task in tasks if not task.path(folder).exists()]
    if not missing:
        return ""
    lines = _simulator(root).run(missing)
    return lines[0] if len(lines) == 1 else f"{len(lines)} side by side, the last: {lines[-1]}"


@functools.lru_cache(maxsize=1)
def _simulator(root: str) -> Simulator:
    return Simulator(Path(root))
