"""Simulate lowered arms: the drapes of a dataset followed from the T-pose down, resumable at any moment."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from tryon_jax.checks import check_range
from tryon_jax.files.pool import open_pool, run_all
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.training.dataset import default_root, read_config, remove_leftovers
from tryon_jax.training.descents import plan_descents, run_descent
from tryon_jax.training.plan import garment_names


@dataclass(frozen=True)
class Config:
    """Which drapes to follow; running again continues where it stopped."""

    data: Path = field(default_factory=default_root)
    """Folder of the dataset; first topologies are followed, whose drapes are stored with their friction."""
    part: Literal["training", "additional", "unseen", "topologies"] = "training"
    """Which of its designs; topologies: the unseen ones of one training design, on the mean body."""
    topology_design: str = "tshirt"
    """Design of `--part topologies`."""
    designs: int = 300
    """At most so many of them, the first ones."""
    bodies: int = 5
    """Body shapes of each: the mean one, and one on each of the first rays."""
    fabrics: tuple[str, ...] = ("all",)
    """Fabrics by name; all of the dataset's by default."""
    processes: int = os.cpu_count() or 1
    """Worker processes, one core each."""


def main(config: Config) -> None:
    """Run all tasks whose files are missing."""
    check_range("bodies", config.bodies, 1, 26)
    check_range("processes", config.processes, 1, 1024)
    root, manifest = config.data.expanduser(), load_manifest()
    simulated = read_config(root).fabrics
    fabrics = simulated if config.fabrics == ("all",) else config.fabrics
    if missing := [fabric for fabric in fabrics if fabric not in simulated]:
        raise ValueError(f"fabrics {missing} are not in the dataset {str(root)!r}; it has {', '.join(simulated)}")
    remove_leftovers(root)
    if config.part == "topologies":
        designs, seeds, bodies = [config.topology_design], manifest.test_seeds, 1
    else:
        designs = [design.label for design in getattr(manifest, config.part)[: config.designs]]
        seeds, bodies = manifest.training_seeds[:1], config.bodies
    tasks = plan_descents(root, manifest, garment_names(manifest, designs, seeds), fabrics, bodies)
    missing_tasks = [task for task in tasks if not task.path(root).exists()]
    with open_pool(config.processes) as pool:
        jobs = [(str(root), task) for task in missing_tasks]
        failed = run_all(pool, "descents", run_descent, jobs, len(tasks) - len(missing_tasks))
    if failed:
        raise RuntimeError(f"{len(failed)} tasks failed, the first: {failed[0]}")
