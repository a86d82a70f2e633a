"""Train R_smooth: the smooth displacement from the mean drape to any body shape."""

from dataclasses import dataclass, field
from pathlib import Path

from experiments.train.curves import draw_curve
from tryon_jax.nets.store import read_record
from tryon_jax.training.dataset import default_root
from tryon_jax.training.recipes import fit_smooth
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.stage_options import StageOptions


@dataclass(frozen=True)
class Config:
    """Where from, where to, and how; a stopped run continues."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run, with R_mean trained."""
    stage: StageOptions = field(default_factory=StageOptions)


def main(config: Config) -> None:
    """Train and report the validation error."""
    fit_smooth(config.data, config.run, config.stage)
    draw_curve(config.run / "smooth", "validation error, mm")
    record = read_record(model_path(config.run))["training"]["smooth"]
    print(f"R_smooth: {record['validation_mm']:.2f} mm on validation shapes, {record['seconds']} s")
