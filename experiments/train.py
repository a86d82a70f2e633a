"""Train everything, one stage after the other: R_mean, R_smooth, R_fine of each fabric, the collision step."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from experiments import train_collisions, train_fine, train_mean, train_smooth
from tryon_jax.training.collisions import CollisionOptions
from tryon_jax.training.dataset import default_root
from tryon_jax.training.recipes import StageOptions


@dataclass(frozen=True)
class Config:
    """Where from, where to, and how long; a stopped run continues."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run; the model is run/model.safetensors."""
    size: Literal["small", "paper"] = "small"
    """Configuration of the networks."""
    reference: Literal["smoothed", "paper"] = "smoothed"
    """What R_smooth's displacement is added to: the smoothed mean drape, or the paper's mean drape."""
    smooth_steps: int = 12000
    fine_steps: int = 8000
    """For each fabric."""
    collision_steps: int = 1500
    """For each fabric."""
    evaluate_every: int = 500


def main(config: Config) -> None:
    """Run the stages; those that are done already take no time."""
    if not (config.run / "mean" / "curve.json").exists():
        train_mean.main(
            train_mean.Config(data=config.data, run=config.run, size=config.size, reference=config.reference)
        )

    def options(steps: int) -> StageOptions:
        default = StageOptions()
        return replace(
            default, loop=replace(default.loop, steps=steps, evaluate_every=min(config.evaluate_every, steps))
        )

    train_smooth.main(train_smooth.Config(config.data, config.run, options(config.smooth_steps)))
    train_fine.main(train_fine.Config(config.data, config.run, (), options(config.fine_steps)))
    default = CollisionOptions()
    every = min(default.loop.evaluate_every, config.collision_steps)
    loop = replace(default.loop, steps=config.collision_steps, evaluate_every=every)
    train_collisions.main(train_collisions.Config(config.run, collisions=CollisionOptions(loop=loop)))
