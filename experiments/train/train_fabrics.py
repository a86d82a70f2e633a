"""Train one R_fine of all fabrics, whose fields a fabric's measured numbers weight, and its collision step."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from experiments.train.curves import draw_curve
from tryon_jax.nets.store import read_record
from tryon_jax.training.all_fabrics import check_fabrics, fit_all_fabrics
from tryon_jax.training.collision_step import fit_collisions
from tryon_jax.training.collisions import CollisionOptions
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.tryon import ALL_FABRICS

HELD_OUT = ("ivory-rib-knit", "tango-red-jet-set")
"""A knitted and a woven fabric, neither of them an extreme in bending length or give among the ten."""


@dataclass(frozen=True)
class Config:
    """Where from, where to, and how; a stopped run continues."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset: few fabrics, many garments."""
    fabric_data: Path = field(default_factory=lambda: default_root().with_name("dataset-fabrics"))
    """Folder of a dataset of many fabrics (`simulate --fabrics all --part additional --designs 40 --rays 2`)."""
    start: Path = Path("runs/small/model.safetensors")
    """Model whose R_mean and R_smooth are taken."""
    run: Path = Path("runs/fabrics")
    """Folder of the run."""
    held_out: tuple[str, ...] = HELD_OUT
    """Fabrics that are not trained on."""
    functions: int = 6
    """Fabric functions."""
    steps: int = 8000
    """Steps of R_fine's training."""
    collision_steps: int = 2000
    """Steps of the collision step; 0 leaves it out."""


def main(config: Config) -> None:
    """Run both stages; one that is done already takes no time."""
    fabrics = tuple(f for f in read_config(config.fabric_data).fabrics if f not in config.held_out)
    check_fabrics(config.data, config.fabric_data, fabrics, config.functions)
    default = StageOptions()
    stage = replace(default, loop=replace(default.loop, steps=config.steps, evaluate_every=min(1000, config.steps)))
    fit_all_fabrics(config.data, config.fabric_data, config.run, config.start, fabrics, config.functions, stage)
    draw_curve(config.run / f"fine-{ALL_FABRICS}", "validation error, mm")
    record = read_record(model_path(config.run))["training"][f"fine-{ALL_FABRICS}"]
    print(f"R_fine of all fabrics: {record['validation_mm']:.2f} mm on validation shapes, {record['seconds']} s")
    if config.collision_steps:
        step = CollisionOptions()
        every = min(step.loop.evaluate_every, config.collision_steps)
        step = replace(step, loop=replace(step.loop, steps=config.collision_steps, evaluate_every=every))
        fit_collisions(config.run, (ALL_FABRICS,), step, config.data, None, config.fabric_data)
        record = read_record(model_path(config.run))["training"][f"collisions-{ALL_FABRICS}"]
        print(
            "inside, held-out garments, before and after: {:.2f} %, {:.2f} %".format(*record["inside_held_out_percent"])
        )
