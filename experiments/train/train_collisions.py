"""Fine-tune R_fine against collisions, self-supervised: random bodies, designs and topologies, no simulation."""

from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path

from experiments.train.curves import draw_curve
from tryon_jax.nets.store import read_record
from tryon_jax.training.collision_step import fit_collisions
from tryon_jax.training.collisions import CollisionOptions
from tryon_jax.training.dataset import default_root
from tryon_jax.training.run_folder import model_path


@dataclass(frozen=True)
class Config:
    """Which run, and how; a stopped run continues."""

    run: Path = Path("runs/small")
    """Folder of the run, with R_fine trained."""
    fabrics: tuple[str, ...] = ()
    """Fabrics to fine-tune; all of the model's when left out."""
    data: Path | None = field(default_factory=default_root)
    """Folder of the simulated dataset, some of whose drapes are replayed."""
    collisions: CollisionOptions = field(default_factory=CollisionOptions)


def main(config: Config, pool: Executor | None = None) -> None:
    """Fine-tune the fabrics, one after the other or on a pool, and report vertices inside the body before and after."""
    fabrics = config.fabrics or tuple(read_record(model_path(config.run))["config"]["fabrics"])
    fit_collisions(config.run, fabrics, config.collisions, config.data, pool)
    for fabric in fabrics:
        draw_curve(config.run / f"collisions-{fabric}", "vertices inside, held-out garments, %")
        record = read_record(model_path(config.run))["training"][f"collisions-{fabric}"]
        for name in ("training", "held_out"):
            before, after = record[f"inside_{name}_percent"]
            change = 100 * (after / before - 1) if before else 0.0
            print(
                f"{fabric}, {name} garments: {before:.3f} % of vertices inside before, "
                f"{after:.3f} % after ({change:+.0f} %)"
            )
