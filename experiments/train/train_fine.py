"""Train R_fine of each fabric: the displacement from the smooth drape to the folds."""

from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path

from experiments.train.curves import draw_curve
from tryon_jax.nets.store import read_record
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.recipes import fit_fine
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.stage_options import StageOptions


@dataclass(frozen=True)
class Config:
    """Where from, where to, and how; a stopped run continues."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run, with R_smooth trained."""
    fabrics: tuple[str, ...] = ()
    """Fabrics to train; all of the dataset's when left out."""
    stage: StageOptions = field(default_factory=StageOptions)


def main(config: Config, pool: Executor | None = None) -> None:
    """Train the fabrics, one after the other or on a pool of processes, and report the validation errors."""
    fabrics = config.fabrics or read_config(config.data).fabrics
    fit_fine(config.data, config.run, fabrics, config.stage, pool)
    for fabric in fabrics:
        draw_curve(config.run / f"fine-{fabric}", "validation error, mm")
        record = read_record(model_path(config.run))["training"][f"fine-{fabric}"]
        print(f"R_fine {fabric}: {record['validation_mm']:.2f} mm on validation shapes, {record['seconds']} s")
