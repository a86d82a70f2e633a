"""The simulated dataset on disk: what lies where, written whole or not at all, read with its splits enforced.

    ROOT/config.json                           what was asked for; a folder belongs to one configuration
    ROOT/reference/<fabric>.npz                drape of the mean design, from which all others of a fabric are reached
    ROOT/reference/guess.npz                   R_mean, by which starting positions of other designs are guessed
    ROOT/meshes/<garment>.npz                  faces, uv, faces_uv, template map of one topology
    ROOT/mean/<garment>_<fabric>.npz           drape on the mean body, with the state to continue from
    ROOT/rays/<garment>_<fabric>_<ray>.npz     drapes along one ray: vertices and slip [N, V, 3], betas, statistics
    ROOT/templates/<design>.npz                drapes of the template on the mean body: for R_mean
    ROOT/samples.csv                           the manifest: every sample, its split, whether it is kept, and why not
    ROOT/checksums.txt                         SHA-256 of every file, as `sha256sum` writes and checks it

<garment> is <design label>-<topology seed>. Every sample carries statistics; `is_good` decides by fixed rules which
are used, and nothing is dropped silently.
"""

import json
import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tryon_jax.files.atomic import atomic_path, write_text
from tryon_jax.physics.stretch import MAX_TENSION

STATISTICS = ("residual", "steps", "depth", "inside", "self_intersections", "tension", "stretch")
MAX_RESIDUAL = 0.02
"""Net force over weight plus contact load."""
MAX_DEPTH = 1e-3
"""Metres that any vertex or face sample may lie inside the body (hands and feet aside)."""
MAX_SELF_INTERSECTIONS = 1e-3
"""Share of faces that pass through another."""
RULES = {
    "residual": MAX_RESIDUAL,
    "depth": MAX_DEPTH,
    "self_intersections": MAX_SELF_INTERSECTIONS,
    "tension": MAX_TENSION,
}
"""Largest value of a statistic that a kept sample may have."""


@dataclass(frozen=True)
class DatasetConfig:
    """What a dataset folder holds; stored in it and compared when it is opened again."""

    body: str = "female"
    layout: str = "kimono"
    num_betas: int = 2
    fabrics: tuple[str, ...] = ("gray-interlock", "white-dots-on-blk")
    target_area: float = 1.78e-4
    """Mean triangle area, m²."""
    dense_vertices: int = 0
    """0: R_mean learns templates fitted to drapes at working density, averaged over the fabrics; else drapes of a dense
    mesh of so many vertices, downsampled, as in the paper (17,246 there)."""
    reference_vertices: int = 2400
    """Vertices of the mesh on which the mean design is dressed (see `reference`)."""
    convention: Literal["reference", "dressed"] = "reference"
    """Where drapes start. reference: from one drape of the mean design (see `reference`), so that folds agree. dressed:
    each garment is dressed by itself and followed along its rays, and folds differ from mesh to mesh by chance."""
    version: int = 2


def default_root() -> Path:
    """Folder for datasets: $TRYON_JAX_DATA, or `tryon_jax/dataset` in the user's cache folder."""
    override = os.environ.get("TRYON_JAX_DATA")
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return Path(override) if override else cache / "tryon_jax" / "dataset"


def open_dataset(root: Path, config: DatasetConfig) -> Path:
    """Create a dataset folder, or check that an existing one was made with the same configuration.

    Raises:
        ValueError: the folder belongs to another configuration; the differing fields are named.
    """
    path = root / "config.json"
    wanted = json.loads(json.dumps(asdict(config)))
    if not path.exists():
        write_text(path, json.dumps(wanted, indent=2) + "\n")
    found = _read_table(path)
    different = [f"{k} = {found.get(k)!r} (asked for {wanted.get(k)!r})" for k in wanted if found.get(k) != wanted[k]]
    if different:
        raise ValueError(f"dataset {str(root)!r} was made with {', '.join(different)}; choose another folder")
    return root


def read_config(root: Path) -> DatasetConfig:
    """Configuration of an existing dataset.

    Raises:
        FileNotFoundError: there is no dataset in the folder.
        ValueError: its config.json is damaged, or of another version of this library.
    """
    if not (root / "config.json").exists():
        raise FileNotFoundError(f"no dataset at {str(root)!r}: run `python -m experiments simulate` first")
    table = _read_table(root / "config.json")
    known = [field.name for field in fields(DatasetConfig)]
    if sorted(table) != sorted(known) or not isinstance(table["fabrics"], list):
        raise ValueError(f"{str(root / 'config.json')!r} must have the entries {', '.join(known)}; found {list(table)}")
    return DatasetConfig(**{**table, "fabrics": tuple(table["fabrics"])})


def _read_table(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text())
    except ValueError as error:
        raise ValueError(f"{str(path)!r} is damaged: {error}") from None
    if not isinstance(table, dict):
        raise ValueError(f"{str(path)!r} is damaged: it must hold one JSON object")
    return table


def remove_leftovers(root: Path, age: float = 3600.0) -> int:
    """Delete temporary files of writers that were killed: hidden files older than `age` seconds; returns how many.

    Younger ones may belong to another process or machine that is writing now.
    """
    oldest = time.time() - age
    old = [path for path in root.rglob(".*.npz") if path.stat().st_mtime < oldest]
    for path in old:
        path.unlink(missing_ok=True)
    return len(old)


def guess_path(root: Path) -> Path:
    """File of the R_mean by which starting positions are guessed."""
    return root / "reference" / "guess.npz"


def reference_path(root: Path, fabric: str) -> Path:
    """File of a fabric's reference drape."""
    return root / "reference" / f"{fabric}.npz"


def mesh_path(root: Path, garment: str) -> Path:
    """File of a garment's mesh."""
    return root / "meshes" / f"{garment}.npz"


def mean_path(root: Path, garment: str, fabric: str) -> Path:
    """File of a garment's drape on the mean body.

    Args:
        root: Folder of the dataset.
        garment: <design label>-<topology seed>.
        fabric: Name of the fabric.
    """
    return root / "mean" / f"{garment}_{fabric}.npz"


def ray_path(root: Path, garment: str, fabric: str, ray: int) -> Path:
    """File of the drapes along one ray.

    Args:
        root: Folder of the dataset.
        garment: <design label>-<topology seed>.
        fabric: Name of the fabric.
        ray: Number of the ray.
    """
    return root / "rays" / f"{garment}_{fabric}_{ray:02d}.npz"


def template_path(root: Path, design: str) -> Path:
    """File of one design's template drape for R_mean."""
    return root / "templates" / f"{design}.npz"


def save_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an npz file in one step."""
    with atomic_path(path) as temporary:
        np.savez(temporary, **arrays)


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read an npz file without unpickling anything.

    Raises:
        FileNotFoundError: it is missing.
        ValueError: it is damaged.
    """
    with path.open("rb") as handle:
        try:
            with np.load(handle, allow_pickle=False) as file:
                return {key: file[key] for key in file.files}
        # A wrong byte can raise almost anything inside zip and npy readers.
        except Exception as error:
            raise ValueError(f"{str(path)!r} is damaged ({error}); delete it and simulate again") from None


def is_good(statistics: Mapping[str, np.ndarray]) -> np.ndarray:
    """Which samples are kept: at rest, outside the body, not through themselves, not under impossible tension."""
    return np.asarray(np.all([statistics[key] <= limit for key, limit in RULES.items()], axis=0))
