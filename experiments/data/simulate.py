"""Simulate the ground-truth dataset (designs x topologies x fabrics x body shapes), resumable at any moment."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from tryon_jax.checks import check_choice, check_range
from tryon_jax.files.atomic import write_text
from tryon_jax.files.pool import checksums, open_pool, run_all
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.physics.fabrics import fabric_names
from tryon_jax.training.dataset import DatasetConfig, default_root, open_dataset, remove_leftovers
from tryon_jax.training.generate import run_batch
from tryon_jax.training.plan import batches, garment_names, plan
from tryon_jax.training.samples import manifest_table, read_samples


@dataclass(frozen=True)
class Config:
    """What to simulate. A folder belongs to one configuration; running again continues where it stopped."""

    out: Path = field(default_factory=default_root)
    """Folder of the dataset."""
    scale: Literal["paper", "small"] = "paper"
    """paper: 19 designs x 2 topologies x 2 fabrics; small: 2 designs x 1 topology at coarse triangles, in minutes."""
    betas: Literal[1, 2] = 2
    """Shape coefficients that vary: 2, or the paper's 1."""
    rays: int = 25
    """Rays of body shapes (at most 25 with two betas, 2 with one); the first ones cover all directions evenly.
    Additional designs need no more than eight, each its own."""
    designs: int = 300
    """With `--part additional`: how many of them, the first ones; there are 1000."""
    part: Literal["training", "additional", "unseen", "topologies"] = "training"
    """training: the 19 training designs in both topologies; additional: further training designs in one; unseen: the
    6 unseen designs; topologies: 7 unseen topologies of one training design."""
    fabrics: tuple[str, ...] = DatasetConfig.fabrics
    """Fabrics, embedded ones by name or `all`."""
    topology_design: str = "tshirt"
    """Design of `--part topologies`."""
    convention: Literal["reference", "dressed"] = "reference"
    """reference: all drapes start from one, so that folds agree between designs and meshes; dressed: each garment is
    dressed by itself, to compare with."""
    dense_vertices: int = 0
    """0: templates for R_mean are fitted to drapes at working density; else simulated on a dense mesh of so many
    vertices and downsampled (17246: the paper)."""
    processes: int = os.cpu_count() or 1
    """Worker processes, one core each; more machines may work on the same folder."""
    batch: int = 1
    """Drapes that a process settles side by side: 1 on a CPU, 50 or more on a GPU (with `--processes 1`). They equal
    those made one by one up to rounding."""
    scheduler: str = ""
    """Address of a Dask scheduler, such as tcp://host:8786, whose workers do the work instead (extra `distributed`);
    they must see the folder at the same path. Samples and checksums do not depend on who simulates them."""


def chosen_fabrics(names: tuple[str, ...]) -> tuple[str, ...]:
    """The fabrics that the option asks for, each once.

    Raises:
        ValueError: There is no such fabric, or none is named.
    """
    if not names:
        raise ValueError("fabrics: name at least one, or all")
    known = fabric_names()
    if names == ("all",):
        return known
    return tuple(dict.fromkeys(check_choice("fabric", name, known) for name in names))


def main(config: Config) -> None:
    """Run all tasks whose files are missing."""
    most = 2 if config.betas == 1 else 25
    check_range("rays", config.rays, 0, most)
    check_range("processes", config.processes, 1, 1024)
    check_range("batch", config.batch, 1, 4096)
    manifest = load_manifest()
    training = [design.label for design in manifest.training]
    designs, seeds = training, manifest.training_seeds
    target_area = manifest.target_area
    if config.scale == "small":
        designs, seeds, target_area = [training[0], training[4]], manifest.training_seeds[:1], 6e-4
    dataset = DatasetConfig(
        num_betas=config.betas,
        fabrics=chosen_fabrics(config.fabrics),
        target_area=target_area,
        dense_vertices=config.dense_vertices,
        convention=config.convention,
    )
    if config.part == "additional":
        designs, seeds = [design.label for design in manifest.additional[: config.designs]], manifest.training_seeds[:1]
    if config.part == "unseen":
        designs, seeds = [design.label for design in manifest.unseen], manifest.training_seeds[:1]
    if config.part == "topologies":
        designs, seeds = [config.topology_design], manifest.test_seeds
    root = open_dataset(config.out.expanduser(), dataset)
    remove_leftovers(root)
    garments = garment_names(manifest, designs, seeds)
    waves = plan(dataset, manifest, garments, config.rays, additional=config.part == "additional")
    failed: list[str] = []
    with open_pool(config.processes, config.scheduler) as pool:
        for name, wave in waves:
            missing = [task for task in wave if not task.path(root).exists()]
            groups = batches(missing, config.batch) if config.batch > 1 else [(task,) for task in missing]
            done = len(wave) - len(missing) if config.batch == 1 else 0
            failed += run_all(pool, name, run_batch, [(str(root), group) for group in groups], done)
    write_text(root / "samples.csv", manifest_table(root, read_samples(root), manifest))
    write_text(root / "checksums.txt", checksums(root))
    if failed:
        raise RuntimeError(f"{len(failed)} tasks failed, the first: {failed[0]}")
