"""Which garments of a simulated dataset are trained on, and their drapes."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from tryon_jax.garment.manifest import Manifest
from tryon_jax.training.carried import fresh_topologies
from tryon_jax.training.dataset import read_config
from tryon_jax.training.drapes import has_drapes
from tryon_jax.training.garments import SimulatedGarment, load_simulated
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.tryon import Garment, TryOnModel


def training_names(root: Path, manifest: Manifest, designs: str = "all") -> list[str]:
    """Garments of a dataset that may be trained on and whose drapes on the mean body are there.

    Args:
        root: Folder of the dataset.
        manifest: Splits of designs and topologies.
        designs: "all", or "paper" for the 19 designs of the paper.
    """
    fabrics = read_config(root).fabrics
    names = manifest.training_garments(additional=designs == "all")
    return [n for n in names if has_drapes(root, n, fabrics)]


def dataset_checksum(root: Path, names: Sequence[str]) -> str:
    """SHA-256 over the contents of the files that a training run on these garments reads."""
    digest = hashlib.sha256((root / "config.json").read_bytes())
    for folder in ("meshes", "mean", "rays", "packed", "templates"):
        for path in sorted((root / folder).glob("[!.]*.npz")):
            if folder == "templates" or path.stem.split("_")[0] in names:
                digest.update(f"{folder}/{path.name}:".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def load_samples(
    model: TryOnModel, root: Path, names: Sequence[str], prepared: Mapping[str, Garment] | None = None
) -> list[SimulatedGarment]:
    """Garments with their drapes, prepared for the model.

    Args:
        model: Its configuration and R_mean.
        root: Folder of the dataset.
        names: <design label>-<topology seed> of each garment.
        prepared: Garments by name that are prepared already.
    """
    fabrics, known = read_config(root).fabrics, prepared or {}
    listed = tqdm(names, desc="garments", mininterval=2)
    return [load_simulated(model, root, name, fabrics, known.get(name)) for name in listed]


def training_samples(
    model: TryOnModel,
    root: Path,
    manifest: Manifest,
    options: StageOptions,
    samples: Sequence[SimulatedGarment] | None,
) -> tuple[list[str], list[SimulatedGarment]]:
    """Names of the simulated garments that are trained on, and them with their fresh topologies.

    Args:
        model: Its configuration and R_mean.
        root: Folder of the dataset.
        manifest: Splits of designs and topologies.
        options: Of the training.
        samples: All garments of `training_names`, where they are loaded already.
    """
    names = training_names(root, manifest, options.designs)
    loaded = load_samples(model, root, names) if samples is None else list(samples)
    return names, loaded + fresh_topologies(model, root, loaded, manifest, options.fresh)
