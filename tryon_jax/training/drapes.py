"""Meshes and drapes of a data set, whether it is the full one or a packed one."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tryon_jax.training.dataset import MAX_RESIDUAL, is_good, load_arrays, mean_path, mesh_path
from tryon_jax.training.packed import Drapes, packed_path, read_packed_drapes, read_packed_mesh


def load_mesh(root: Path, garment: str) -> dict[str, np.ndarray]:
    """The arrays of a garment's mesh (see `dataset`)."""
    packed = packed_path(root, garment)
    return read_packed_mesh(packed) if packed.exists() else load_arrays(mesh_path(root, garment))


def has_drapes(root: Path, garment: str, fabrics: Sequence[str]) -> bool:
    """Whether the garment was draped on the mean body in all these fabrics.

    Args:
        root: Folder of the dataset.
        garment: <design label>-<topology seed>.
        fabrics: Names.
    """
    return packed_path(root, garment).exists() or all(mean_path(root, garment, fabric).exists() for fabric in fabrics)


def load_drapes(root: Path, garment: str, fabric: str) -> Drapes:
    """Every drape of a garment in one fabric; the mean body belongs to training.

    Args:
        root: Folder of the dataset.
        garment: <design label>-<topology seed>.
        fabric: Name.

    Raises:
        FileNotFoundError: there is none on the mean body.
    """
    packed = packed_path(root, garment)
    if packed.exists():
        return read_packed_drapes(packed, fabric)
    path = mean_path(root, garment, fabric)
    if not path.exists():
        raise FileNotFoundError(f"dataset {str(root)!r} has no drape of {garment} in {fabric} on the mean body")
    mean = load_arrays(path)
    rays = [load_arrays(p) for p in sorted((root / "rays").glob(f"{garment}_{fabric}_*.npz"))]
    width = rays[0]["betas"].shape[1] if rays else 2
    betas = np.concatenate([np.zeros((1, width)), *[np.round(ray["betas"], 6) for ray in rays]])
    test = np.concatenate([np.zeros(1, bool), *[ray["test"].astype(bool) for ray in rays]])
    good = np.concatenate([[bool(is_good(mean))], *[is_good(ray) for ray in rays]]).astype(bool)
    residuals = np.concatenate([[float(mean["residual"])], *[ray["residual"] for ray in rays]])
    vertices = np.concatenate([mean["vertices"][None], *[ray["vertices"] for ray in rays]])
    return Drapes(betas, vertices, test, good, residuals <= MAX_RESIDUAL)
