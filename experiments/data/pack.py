"""Pack a simulated data set so that it travels: modes and coefficients of each garment and fabric, on a grid.

python -m experiments pack --data DATA --out PACKED

Training reads the packed set as it reads the full one. No drape is moved by more than `--max-error` on average over its
vertices. Where the set would be too large, additional designs are left out, the last ones first, and the summary says
so.
"""

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from tryon_jax.checks import check_range
from tryon_jax.files.atomic import write_bytes
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.training.dataset import default_root, load_arrays, open_dataset, read_config
from tryon_jax.training.drapes import has_drapes, load_drapes, load_mesh
from tryon_jax.training.packed import MAX_ERROR, Packing, pack_garment, packed_path, write_summary
from tryon_jax.training.training_set import dataset_checksum


@dataclass(frozen=True)
class Config:
    """What to pack, where to, how well."""

    data: Path = field(default_factory=default_root)
    """Folder of the full data set."""
    out: Path = Path("packed")
    """Folder of the packed one."""
    max_error: float = 1e3 * MAX_ERROR
    """Mean distance over a drape's vertices, test shapes included, that packing may move it at most, millimetres."""
    max_megabytes: float = 48.0
    """Size of the packed folder at most, 10⁶ bytes; additional designs beyond it are left out, the last ones first."""


def main(config: Config) -> None:
    """Pack, and say what was reached."""
    check_range("max_error", config.max_error, 0.02, 5.0, "mm")
    check_range("max_megabytes", config.max_megabytes, 1e-3, 1e5)
    dataset, manifest = read_config(config.data), load_manifest()
    if (config.data / "packed").exists():
        raise ValueError(f"data = {str(config.data)!r} is a packed set already; pack the full one")
    needed, additional = _garments(config.data, manifest, dataset.fabrics)
    if not needed + additional:
        raise ValueError(f"data = {str(config.data)!r} has no garment that is draped in all of its fabrics")
    root = open_dataset(config.out, dataset)
    room = 1e6 * config.max_megabytes - _pack_templates(config.data, root)
    found: dict[str, dict[str, Packing]] = {}
    size, left_out = 0, []
    for name in tqdm(needed + additional, desc="garments", mininterval=2):
        path = packed_path(root, name)
        fabrics = {fabric: load_drapes(config.data, name, fabric) for fabric in dataset.fabrics}
        reached = pack_garment(path, load_mesh(config.data, name), fabrics, 1e-3 * config.max_error)
        # The summary takes half a kilobyte a garment.
        bytes_here = path.stat().st_size + 600 * len(fabrics)
        if size + bytes_here > room:
            path.unlink()
            if name in needed:
                raise ValueError(
                    f"max_megabytes = {config.max_megabytes:g} holds {len(found)} garments; {name} is needed too: "
                    "allow more, or a larger max_error"
                )
            left_out = additional[additional.index(name) :]
            break
        size += bytes_here
        found[name] = reached
    for path in (root / "packed").glob("*.npz"):
        if path.stem not in found:
            path.unlink()
    write_summary(root, dataset_checksum(config.data, list(found)), 1e-3 * config.max_error, found)
    print(summary(root, found, left_out))


def _garments(root: Path, manifest: Manifest, fabrics: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Names of garments that have been draped: those of the paper and of the tests, then the additional ones."""
    seeds = manifest.training_seeds + manifest.test_seeds
    own = [f"{design.label}-{seed}" for design in (*manifest.training, *manifest.unseen) for seed in seeds]
    more = [f"{design.label}-{manifest.training_seeds[0]}" for design in manifest.additional]
    needed, additional = ([n for n in names if has_drapes(root, n, fabrics)] for names in (own, more))
    return needed, additional


def _pack_templates(source: Path, root: Path) -> int:
    """Write the templates in single precision; their bytes."""
    total = 0
    for path in sorted((source / "templates").glob("[!.]*.npz")):
        arrays: dict[str, Any] = dict(load_arrays(path))
        arrays["template"] = arrays["template"].astype(np.float32)
        file = io.BytesIO()
        np.savez_compressed(file, **arrays)
        write_bytes(root / "templates" / path.name, file.getvalue())
        total += len(file.getvalue())
    return total


def summary(root: Path, found: dict[str, dict[str, Packing]], left_out: list[str]) -> str:
    """What the packed set holds and how far its drapes are from the full set's."""
    rows = [row for of in found.values() for row in of.values()]
    bytes_all = sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
    modes = [row.modes for row in rows]
    lines = [
        f"{len(found)} garments, {sum(row.drapes for row in rows)} drapes, {bytes_all / 1e6:.1f} MB in {root}",
        f"modes of a garment and fabric: {min(modes)} to {max(modes)}, {np.mean(modes):.0f} on average",
        f"mean distance over a drape's vertices: {max(row.worst_mm for row in rows):.3f} mm at most, "
        f"{max(row.worst_test_mm for row in rows):.3f} mm at most on test shapes, "
        f"{np.average([row.mean_mm for row in rows], weights=[max(row.drapes, 1) for row in rows]):.3f} mm on average; "
        f"one vertex by {max(row.largest_mm for row in rows):.2f} mm at most",
    ]
    if left_out:
        lines.append(f"left out for their size: {len(left_out)} additional designs, from {left_out[0]} on")
    return "\n".join(lines)
