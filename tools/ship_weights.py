"""Put a run's weights into the package, in half precision where that changes no drape by 0.1 mm.

python -m tools.ship_weights runs/small
"""

import sys
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from tryon_jax.nets.store import read_record
from tryon_jax.training.recipes import model_path
from tryon_jax.tryon import TryOnModel, drape, load_model, prepare, save_model

LIMIT = 1e-4
"""Metres."""
DESIGNS = ("tank", "tshirt", "sweater", "dress", "maxi-dress")
SHAPES = np.array([[0.0, 0.0], [2.5, 0.5], [-2.5, -0.5], [0.5, 1.8], [-0.5, -1.8]], np.float32)
MODELS = Path("tryon_jax/data/models")


def largest_change(one: TryOnModel, other: TryOnModel) -> float:
    """Largest distance between the drapes of two models over designs, shapes and fabrics, metres."""
    run = jax.jit(drape, static_argnames="fabric")
    worst = 0.0
    shapes = jnp.asarray(SHAPES[:, : one.config.num_betas])
    for design in DESIGNS:
        garment = prepare(one, design)
        for fabric in one.config.fabrics:
            difference = garment.unpad(run(one, garment, shapes, fabric=fabric)) - garment.unpad(
                run(other, garment, shapes, fabric=fabric)
            )
            worst = max(worst, float(np.linalg.norm(difference, axis=-1).max()))
    return worst


def main(run: Path, name: str = "small") -> None:
    """Write tryon_jax/data/models/NAME.safetensors."""
    source = model_path(run)
    model, record = load_model(source), read_record(source)["training"]
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
