"""Drape random garments × random bodies with `tryon catalogue`: both lists are drawn by number from a seed."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_range
from tryon_jax.commands import catalogue
from tryon_jax.files.atomic import write_text
from tryon_jax.files.pool import available_cores, checksums
from tryon_jax.garment import Design
from tryon_jax.tryon import TryOnModel, config_space, load_model, load_pretrained


@dataclass(frozen=True)
class Config:
    """What to drape, and where; running again continues where it stopped."""

    out: Path = Path("catalogue")
    """Folder of the drapes."""
    garments: int = 100
    """Random designs of the model's design space."""
    bodies: int = 256
    """Random body shapes, the same for all garments."""
    seed: int = 0
    fabric: str = "gray-interlock"
    push_out: bool = False
    """Push every drape out of its body."""
    fit: bool = False
    """Measure and judge every drape."""
    block: int = 64
    """Bodies in a file."""
    weights: Path | None = None
    """File of learned parameters in place of those that come with the package."""
    processes: int = field(default_factory=available_cores)
    """Worker processes, one core each."""
    scheduler: str = ""
    """Address of a Dask scheduler whose workers do the work instead (extra `distributed`)."""


def random_design(model: TryOnModel, seed: int, garment: int) -> Design:
    """Design of a garment by its number, evenly spread over the design space."""
    space = config_space(model.config)
    share = np.random.default_rng((seed, 0, garment)).random(len(space.names))
    return space.from_values(space.minimum + share * (space.maximum - space.minimum))


def random_betas(seed: int, numbers: np.ndarray, extent: tuple[float, ...]) -> Float[np.ndarray, "B b"]:
    """Betas of bodies by their numbers, evenly spread over an ellipse with the half axes `extent`."""
    rows = []
    for number in numbers:
        rng = np.random.default_rng((seed, 1, int(number)))
        direction = rng.normal(size=len(extent))
        rows.append(direction / np.linalg.norm(direction) * rng.random() ** (1 / len(extent)))
    return (np.array(rows) * np.array(extent)[None]).astype(np.float32)


def main(config: Config) -> None:
    """Write the two lists, drape what is missing, and write checksums.txt."""
    check_range("garments", config.garments, 1, 10**9)
    check_range("bodies", config.bodies, 1, 10**9)
    model = load_pretrained() if config.weights is None else load_model(config.weights)
    root = config.out.expanduser().resolve()
    designs = [random_design(model, config.seed, number).as_dict() for number in range(config.garments)]
    rows = [f"{n:06d}," + " ".join(f"{k}={v!r}" for k, v in design.items()) for n, design in enumerate(designs)]
    garments = root / "designs.csv"
    write_text(garments, "\n".join(["name,set", *rows]) + "\n")
    shapes = random_betas(config.seed, np.arange(config.bodies), model.config.beta_ranges)
    rows = [f"{n:06d}," + " ".join(f"{beta:.9g}" for beta in betas) for n, betas in enumerate(shapes.tolist())]
    bodies = root / "bodies.csv"
    write_text(bodies, "\n".join(["name,betas", *rows]) + "\n")
    catalogue.main(
        catalogue.Config(
            garments,
            bodies,
            root,
            fabric=config.fabric,
            push_out=config.push_out,
            fit=config.fit,
            block=config.block,
            weights=config.weights,
            processes=config.processes,
            scheduler=config.scheduler,
        )
    )
    write_text(root / "checksums.txt", checksums(root))
