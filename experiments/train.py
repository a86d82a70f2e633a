"""Train everything, from a data set to a model: R_mean, R_smooth, R_fine of each fabric, the collision step."""

import os
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from experiments import train_collisions, train_fine, train_mean, train_smooth
from experiments._pool import open_pool
from tryon_jax.nets.config import Conditioning
from tryon_jax.training.collisions import CollisionOptions
from tryon_jax.training.dataset import default_root
from tryon_jax.training.recipes import StageOptions


def _stage(steps: int) -> StageOptions:
    default = StageOptions()
    return replace(default, loop=replace(default.loop, steps=steps, evaluate_every=min(500, steps)))


@dataclass(frozen=True)
class Config:
    """Where from, where to, and how long; a stopped run continues."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run; the model is run/model.safetensors."""
    size: Literal["small", "paper"] = "small"
    """Configuration of the networks."""
    conditioning: Conditioning = "fields"
    """fields: the networks predict displacement fields; node: the paper's form, with the betas at each node."""
    reference: Literal["smoothed", "paper"] = "smoothed"
    """What R_smooth's displacement is added to: the smoothed mean drape, or the paper's mean drape."""
    smooth: StageOptions = field(default_factory=lambda: _stage(8000))
    """Training of R_smooth."""
    fine: StageOptions = field(default_factory=lambda: _stage(12000))
    """Training of R_fine, for each fabric."""
    collisions: CollisionOptions = field(default_factory=CollisionOptions)
    """The collision step, for each fabric; no steps leave it out."""
    processes: int = min(2, os.cpu_count() or 1)
    """Fabrics that are trained side by side, one core each; 1 uses all cores for one after the other."""


def main(config: Config) -> None:
    """Run the stages; those that are done already take no time."""
    if not (config.run / "mean" / "curve.json").exists():
        train_mean.main(train_mean.Config(config.data, config.run, config.size, config.conditioning, config.reference))
    train_smooth.main(train_smooth.Config(config.data, config.run, config.smooth))
    with open_pool(config.processes) if config.processes > 1 else nullcontext() as pool:
        train_fine.main(train_fine.Config(config.data, config.run, (), config.fine), pool)
        if config.collisions.loop.steps:
            step = train_collisions.Config(config.run, (), config.data, config.collisions)
            train_collisions.main(step, pool)
