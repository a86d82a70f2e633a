"""Train everything, from a data set to a model: R_mean, R_smooth, kriging, R_fine of each fabric; or the paper's form,
with its collision step."""

import os
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from experiments.train import train_collisions, train_fine, train_kriging, train_mean, train_smooth
from tryon_jax.files.pool import open_pool
from tryon_jax.nets.config import Size
from tryon_jax.nets.store import read_record
from tryon_jax.training.collisions import CollisionOptions
from tryon_jax.training.dataset import default_root
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.stage_options import StageOptions


@dataclass(frozen=True)
class Config:
    """Where from, where to, and how long; a stopped run continues."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run; the model is run/model.safetensors."""
    size: Size = "small"
    """Configuration of the networks; with -node in the paper's form, with the betas at each node."""
    reference: Literal["smoothed", "paper"] = "smoothed"
    """What R_smooth's displacement is added to: the smoothed mean drape, or the paper's mean drape."""
    smooth_steps: int = 4000
    """Steps of R_smooth's training."""
    kriging: bool = True
    """R_fine starts from kriged drapes of designs in place of M_smooth; never in the paper's form."""
    fine_steps: int | None = None
    """Steps of R_fine's, for each fabric; by default 6000 from kriged drapes and 12000 from M_smooth."""
    collision_steps: int | None = None
    """Steps of the collision step, for each fabric, 0 leaves it out; by default 2000 from M_smooth, and none from
    kriged drapes, which it would blur: `drape` corrects what they leave."""
    shapes: int = 16
    """Body shapes of each garment in a batch."""
    evaluate_every: int = 1000
    """Steps from one validation to the next."""
    processes: int = min(2, os.cpu_count() or 1)
    """Fabrics that are trained side by side, one core each; 1 uses all cores for one after the other."""


def main(config: Config) -> None:
    """Run the stages; those that are done already take no time."""
    if not (config.run / "mean" / "curve.json").exists():
        train_mean.main(train_mean.Config(config.data, config.run, config.size, config.reference))
    train_smooth.main(train_smooth.Config(config.data, config.run, _options(config, config.smooth_steps)))
    kriged = config.kriging and not config.size.endswith("-node")
    if kriged and not _has_kriging(config.run):
        train_kriging.main(train_kriging.Config(config.data, config.run))
    fine_steps = (6000 if kriged else 12000) if config.fine_steps is None else config.fine_steps
    with open_pool(config.processes) if config.processes > 1 else nullcontext() as pool:
        train_fine.main(train_fine.Config(config.data, config.run, (), _options(config, fine_steps)), pool)
        step = CollisionOptions()
        default = 0 if kriged else step.loop.steps
        steps = default if config.collision_steps is None else config.collision_steps
        if steps:
            every = min(step.loop.evaluate_every, steps)
            # Each step sees one garment: a short run needs no more of them than it has steps.
            pool_size = min(step.pool, max(steps, step.held_out))
            step = replace(step, loop=replace(step.loop, steps=steps, evaluate_every=every), pool=pool_size)
            train_collisions.main(train_collisions.Config(config.run, (), config.data, step), pool)


def _has_kriging(run: Path) -> bool:
    return any(name.startswith("kriging-") for name in read_record(model_path(run))["training"])


def _options(config: Config, steps: int) -> StageOptions:
    default = StageOptions()
    loop = replace(default.loop, steps=steps, evaluate_every=min(config.evaluate_every, steps))
    return replace(default, loop=loop, shapes=config.shapes)
