"""Write the drape in float64 that `python -m benchmarks gpu` compares a device's own with before it measures anything.

python -m benchmarks float64          (once for each new set of weights in the package)
"""

import hashlib
import time
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._fields import ReferenceFields, fields_model
from benchmarks._garments import garment_of_mesh, mesh_of_size
from benchmarks._subjects import rounding_mm
from tryon_jax.training.dataset import load_arrays, save_arrays
from tryon_jax.tryon import Garment, TryOnModel, drape

STORED = Path(__file__).parent / "reference" / "drape.npz"
"""Mesh on the mean body, betas, the drape in float64 by NumPy and SciPy, and the weights that it is of."""
TOLERANCE = 0.01
"""Millimetres that a vertex may be off in float32."""


@dataclass(frozen=True)
class Config:
    """Which drape, and where to."""

    vertices: int = 1414
    """Size of the garment."""
    betas: tuple[float, ...] = (1.5, -0.8)
    """Shape of the body."""
    out: Path = STORED


def weights_checksum() -> str:
    """SHA-256 of the weights that come with the package."""
    file = resources.files("tryon_jax") / "data" / "models" / "small.safetensors"
    return hashlib.sha256(file.read_bytes()).hexdigest()


def stored_garment(model: TryOnModel, stored: dict[str, np.ndarray]) -> Garment:
    """The garment of a stored mesh: nothing of it is meshed anew, so that no device has another one."""
    c = model.config
    faces = stored["faces"].astype(np.int32)
    return garment_of_mesh(
        stored["mean"].astype(np.float64), faces, c.body, c.num_levels, c.pooling, c.laplacian, c.smoothing_length
    )


def check_drape(path: Path = STORED) -> dict[str, Any]:
    """Drape the stored garment in float32 on this device and compare it with the stored result.

    Returns:
        Largest distance in millimetres, what is allowed, and the seconds that it took.

    Raises:
        ValueError: they differ by more than rounding, or what is stored is of other weights.
    """
    start, stored = time.perf_counter(), load_arrays(path)
    if str(stored["weights"]) != weights_checksum():
        raise ValueError(f"{str(path)!r} is of other weights than the package's: run `python -m benchmarks float64`")
    model = fields_model("small")
    garment = stored_garment(model, stored)
    with jax.default_matmul_precision("float32"):
        made = jax.jit(drape, static_argnames="fabric")(model, garment, jnp.asarray(stored["betas"], jnp.float32))
    found = garment.unpad(made).astype(np.float64)
    error = rounding_mm(found, stored["drape"])
    if not error <= TOLERANCE:
        raise ValueError(
            f"the drape on {jax.devices()[0].device_kind} is {error:.3g} mm from float64, more than {TOLERANCE:g} mm: "
            "nothing is measured"
        )
    took = round(time.perf_counter() - start, 2)
    return {"error_mm": error, "tolerance_mm": TOLERANCE, "vertices": len(found), "took_s": took}


def main(config: Config) -> None:
    """Make the garment, drape it in float64, write both."""
    model, mesh = fields_model("small"), mesh_of_size(config.vertices)
    betas = np.asarray(config.betas, np.float64)
    stored: dict[str, Any] = {"mean": mesh.mean.astype(np.float32), "faces": mesh.faces.astype(np.uint16)}
    garment = stored_garment(model, stored)
    exact = ReferenceFields(model, garment, model.config.fabrics[0]).drape(betas)[: garment.num_vertices]
    save_arrays(config.out, stored | {"betas": betas, "drape": exact, "weights": np.array(weights_checksum())})
    print(
        f"wrote {config.out}: {len(exact)} vertices; here float32 is {check_drape(config.out)['error_mm']:.2g} mm off"
    )
