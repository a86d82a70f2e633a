"""Krige the drapes of designs in each fabric, which R_fine then starts from in place of M_smooth."""

from dataclasses import dataclass, field
from pathlib import Path

from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.nets.store import read_record
from tryon_jax.training.dataset import default_root
from tryon_jax.training.kriging_stage import fit_kriging
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import load_model


@dataclass(frozen=True)
class Config:
    """Where from, where to, and how."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run, with R_mean trained."""
    kriging: KrigingConfig = field(default_factory=KrigingConfig)
    """Kernel and sizes."""


def main(config: Config) -> None:
    """Fit all fabrics and report the validation errors."""
    fabrics = load_model(model_path(config.run)).config.fabrics
    fit_kriging(config.data, config.run, fabrics, config.kriging)
    for fabric in fabrics:
        record = read_record(model_path(config.run))["training"][f"kriging-{fabric}"]
        print(f"kriging {fabric}: {record['validation_mm']:.2f} mm on validation shapes, {record['seconds']} s")
