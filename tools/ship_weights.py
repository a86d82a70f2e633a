"""Put a run's weights into the package, in half precision where that changes no drape by 0.1 mm.

Weights that tear a garment on any body of a wide range are refused: mean errors do not show one collapsed collar.

python -m tools.ship_weights runs/small
"""

import sys
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tryon_jax.metrics import edge_strain
from tryon_jax.nets.store import read_record
from tryon_jax.training.recipes import model_path
from tryon_jax.tryon import TryOnModel, drape, load_model, prepare, save_model

LIMIT = 1e-4
"""Metres."""
TORN = 1.0
"""Strain of an edge, against the drape on the mean body, from which a garment counts as torn."""
DESIGNS = ("tank", "tshirt", "sweater", "dress", "maxi-dress")
SHAPES = np.array([[0.0, 0.0], [2.5, 0.5], [-2.5, -0.5], [0.5, 1.8], [-0.5, -1.8]], np.float32)
MODELS = Path("tryon_jax/data/models")
_drape = jax.jit(drape, static_argnames="fabric")


def largest_change(one: TryOnModel, other: TryOnModel) -> float:
    """Largest distance between the drapes of two models over designs, shapes and fabrics, metres."""
    worst = 0.0
    shapes = jnp.asarray(SHAPES[:, : one.config.num_betas])
    for design in DESIGNS:
        garment = prepare(one, design)
        for fabric in one.config.fabrics:
            difference = garment.unpad(_drape(one, garment, shapes, fabric=fabric)) - garment.unpad(
                _drape(other, garment, shapes, fabric=fabric)
            )
            worst = max(worst, float(np.linalg.norm(difference, axis=-1).max()))
    return worst


def bodies_all_over_the_range() -> Float[np.ndarray, "74 2"]:
    """Betas on three ellipses, 15 degrees apart, and near the ends of the build axis."""
    angles = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    rings = [r * np.stack([3 * np.cos(angles), 2 * np.sin(angles)], 1) for r in (0.5, 0.8, 0.95)]
    return np.concatenate([*rings, [[0.5, 1.8], [-0.5, -1.8]]]).astype(np.float32)


def largest_strain(model: TryOnModel, design: str, fabric: str) -> tuple[float, Float[np.ndarray, " 2"]]:
    """Largest strain of any edge against the drape on the mean body, and the betas where it is."""
    garment = prepare(model, design)
    betas = bodies_all_over_the_range()
    drapes = garment.unpad(_drape(model, garment, betas, fabric=fabric))
    strains = [edge_strain(row, garment.faces, garment.mean_vertices, garment.faces).max() for row in drapes]
    worst = int(np.argmax(strains))
    return float(strains[worst]), betas[worst]


def main(run: Path, name: str = "small") -> None:
    """Write tryon_jax/data/models/NAME.safetensors.

    Raises:
        ValueError: the weights tear a garment.
    """
    source = model_path(run)
    model, record = load_model(source), read_record(source)["training"]
    for design in DESIGNS:
        for fabric in model.config.fabrics:
            strain, betas = largest_strain(model, design, fabric)
            print(f"{design} in {fabric}: edges stretch by {strain:.2f} at most, on betas {betas}")
            if strain >= TORN:
                raise ValueError(
                    f"{source} tears {design} in {fabric} on betas {betas}: strain {strain:.2f}, not < {TORN}"
                )
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / "half.safetensors"
        save_model(trial, model, record, half=True)
        change = largest_change(model, load_model(trial))
    half = change < LIMIT
    path = MODELS / f"{name}.safetensors"
    save_model(path, model, record, half=half)
    print(f"half precision moves vertices by {1e3 * change:.3f} mm at most: {'used' if half else 'not used'}")
    print(f"wrote {path}, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit("usage: python -m tools.ship_weights RUN [NAME]")
    main(Path(sys.argv[1]), *sys.argv[2:])
