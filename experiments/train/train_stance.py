"""Train R_stance: what lowered arms change in a drape, in any fabric."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from experiments.train.curves import draw_curve
from experiments.train.train_fabrics import HELD_OUT
from tryon_jax.checks import check_range
from tryon_jax.nets.store import read_record
from tryon_jax.physics.fabrics import fabric_names
from tryon_jax.training.dataset import default_root
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stance_network import StanceOptions, fit_stance


@dataclass(frozen=True)
class Config:
    """Where from, where to, and how; a stopped run continues."""

    data: tuple[Path, ...] = field(
        default_factory=lambda: (default_root(), default_root().with_name("dataset-fabrics"))
    )
    """Folders of simulated datasets with descents (`simulate_stances`): few fabrics, and all."""
    start: Path = Path("runs/small/model.safetensors")
    """Model that it is for."""
    run: Path = Path("runs/stance")
    """Folder of the run; the result is stance.safetensors in it."""
    held_out: tuple[str, ...] = HELD_OUT
    """Fabrics that are not trained on."""
    functions: int = 3
    """Fabric functions."""
    fields: int = 16
    """Displacement fields."""
    steps: int = 4000
    """Steps of training."""


def main(config: Config) -> None:
    """Train it; what is done already takes no time."""
    check_range("steps", config.steps, 1, 10_000_000)
    fabrics = tuple(name for name in fabric_names() if name not in config.held_out)
    default = StageOptions()
    loop = replace(default.loop, steps=config.steps, evaluate_every=min(500, config.steps))
    stage = replace(default, loop=loop)
    options = StanceOptions(fabrics, config.functions, config.fields, stage=stage)
    fit_stance(config.data, config.start, config.run, options)
    draw_curve(config.run / "stance", "validation error, mm")
    record = read_record(config.run / "stance.safetensors")["training"]["stance"]
    print(f"R_stance: {record['validation_mm']:.2f} mm on designs that were not fitted, {record['seconds']} s")
