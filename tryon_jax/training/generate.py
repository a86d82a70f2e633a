"""Simulating the dataset: tasks that any number of processes may work on.

A task writes one file in one step and does nothing where the file exists, so work can stop at any moment, and be done
twice without harm.
"""

import functools
import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Sequence
from pathlib import Path

from tryon_jax.training.bench import Bench, fit_template
from tryon_jax.training.plan import Task, batches, garment_names, plan, template_designs

__all__ = [
    "Bench",
    "Task",
    "batches",
    "end_with_parent",
    "fit_template",
    "garment_names",
    "plan",
    "run_batch",
    "run_task",
    "template_designs",
]


def run_task(root: str, task: Task) -> str:
    """Do a task unless its file exists; returns a line for the log ("" when there was nothing to do)."""
    folder = Path(root)
    if task.path(folder).exists():
        return ""
    bench = _bench(root)
    if task.kind == "mean":
        return bench.simulate_mean(task)
    if task.kind == "ray":
        return bench.simulate_ray(task)
    return bench.simulate_template(task)


def run_batch(root: str, tasks: Sequence[Task]) -> str:
    """Do those tasks whose files are missing side by side, which pays on a GPU; all of one kind (see `plan.batches`).

    Returns a line for the log ("" when there was nothing to do).
    """
    folder = Path(root)
    missing = [task for task in tasks if not task.path(folder).exists()]
    if not missing:
        return ""
    bench = _bench(root)
    work = {"mean": bench.simulate_means, "ray": bench.simulate_rays, "template": bench.simulate_templates}
    lines = work[missing[0].kind](missing)
    return f"{len(lines)} side by side, the last: {lines[-1]}"


def end_with_parent() -> None:
    """Let this worker end when the process that started it does, even if that is killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@functools.lru_cache(maxsize=1)
def _bench(root: str) -> Bench:
    return Bench(Path(root))
