"""Train R_mean: design parameters to the template's drape on the mean body."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from tryon_jax.garment import load_design_space
from tryon_jax.nets.config import Size, load_config
from tryon_jax.nets.store import read_record
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.mean import MeanTraining
from tryon_jax.training.protocol import EXTENT
from tryon_jax.training.recipes import fit_mean
from tryon_jax.training.run_folder import model_path


@dataclass(frozen=True)
class Config:
    """Where from, where to, and how."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run; the model is run/model.safetensors."""
    size: Size = "small"
    """Configuration of the networks; with -node in the paper's form, with the betas at each node."""
    reference: Literal["smoothed", "paper"] = "smoothed"
    """What R_smooth's displacement is added to: the smoothed mean drape, or the paper's mean drape."""
    mean: MeanTraining = field(default_factory=MeanTraining)


def main(config: Config) -> None:
    """Train and report the error on held-out designs."""
    dataset = read_config(config.data)
    network = load_config(
        config.size,
        body=dataset.body,
        layout=dataset.layout,
        fabrics=dataset.fabrics,
        num_betas=dataset.num_betas,
        beta_extent=EXTENT[: dataset.num_betas],
        target_area=dataset.target_area,
        reference=config.reference,
        num_parameters=len(load_design_space(dataset.layout).names),
    )
    fit_mean(config.data, config.run, network, config.mean)
    record = read_record(model_path(config.run))["training"]["mean"]
    print(
        f"R_mean: {record['validation_mm']:.2f} mm on held-out designs, {record['training_mm']:.2f} mm on all "
        f"{record['designs']} (mean over template vertices)"
    )
