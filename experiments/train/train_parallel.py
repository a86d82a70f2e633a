"""Train a stage over several processes (and machines) that work as one; give the same command to each of them.

On one machine with several GPUs this is not needed: `train_smooth` and the others use all devices that JAX sees.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from experiments.train import train_collisions, train_fine, train_smooth
from tryon_jax.training.collisions import CollisionOptions
from tryon_jax.training.dataset import default_root
from tryon_jax.training.parallel import joined_processes
from tryon_jax.training.stage_options import StageOptions


@dataclass(frozen=True)
class Config:
    """Which stage, and who takes part. A run whose processes were lost continues when all are started again."""

    which: Literal["smooth", "fine", "collisions"] = "smooth"
    """R_smooth, R_fine of each fabric, or the collision step."""
    coordinator: str = "localhost:12345"
    """host:port of process 0, where all others reach it."""
    processes: int = 1
    """How many processes take part."""
    process: int = 0
    """Number of this process, from 0."""
    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset; every process must see it."""
    run: Path = Path("runs/small")
    """Folder of the run; every process must see it, and the first one writes it."""
    fabrics: tuple[str, ...] = ()
    """Fabrics to train; all of them when left out."""
    stage: StageOptions = field(default_factory=StageOptions)
    """Options of R_smooth and R_fine; `shapes` must be a multiple of the number of devices in all processes."""
    collisions: CollisionOptions = field(default_factory=CollisionOptions)
    """Options of the collision step; `shapes` as above."""


def main(config: Config) -> None:
    """Join the others and train."""
    with joined_processes(config.coordinator, config.processes, config.process):
        if config.which == "smooth":
            train_smooth.main(train_smooth.Config(config.data, config.run, config.stage))
        elif config.which == "fine":
            train_fine.main(train_fine.Config(config.data, config.run, config.fabrics, config.stage))
        else:
            train_collisions.main(train_collisions.Config(config.run, config.fabrics, config.data, config.collisions))
