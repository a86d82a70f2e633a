"""Simulate the ground-truth dataset (designs x topologies x fabrics x body shapes), resumable at any moment."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from tqdm import tqdm

from tryon_jax.checks import check_range
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.training.dataset import DatasetConfig, default_root, open_dataset
from tryon_jax.training.generate import Task, end_with_parent, garment_names, plan, run_task


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
    """Rays of body shapes (at most 25 with two betas, 2 with one); the first ones cover all directions evenly."""
    part: Literal["training", "additional", "unseen", "topologies"] = "training"
    """training: the 19 training designs in both topologies; additional: further training designs in one; unseen: the
    6 unseen designs; topologies: 7 unseen topologies of one training design."""
    topology_design: str = "tshirt"
    """Design of `--part topologies`."""
    templates: int = 120
    """Designs draped for R_mean (with `--part training`)."""
    dense_vertices: int = 0
    """0: templates for R_mean are fitted to drapes at working density; else simulated on a dense mesh of so many
    vertices and downsampled (17246: the paper)."""
    processes: int = os.cpu_count() or 1
    """Worker processes, one core each; more machines may work on the same folder."""


def main(config: Config) -> None:
    """Run all tasks whose files are missing."""
    most = 2 if config.betas == 1 else 25
    check_range("rays", config.rays, 0, most)
    check_range("processes", config.processes, 1, 1024)
    manifest = load_manifest()
    training = [design.label for design in manifest.training]
    if config.scale == "small":
        dataset = DatasetConfig(num_betas=config.betas, target_area=6e-4, dense_vertices=config.dense_vertices)
        designs, seeds = [training[0], training[4]], manifest.training_seeds[:1]
    else:
        dataset = DatasetConfig(
            num_betas=config.betas, target_area=manifest.target_area, dense_vertices=config.dense_vertices
        )
        designs, seeds = training, manifest.training_seeds
    templates = config.templates
    if config.part != "training":
        templates = 0
    if config.part == "additional":
        designs, seeds = [design.label for design in manifest.additional], manifest.training_seeds[:1]
    if config.part == "unseen":
        designs, seeds = [design.label for design in manifest.unseen], manifest.training_seeds[:1]
    if config.part == "topologies":
        designs, seeds = [config.topology_design], manifest.test_seeds
    root = open_dataset(config.out.expanduser(), dataset)
    waves = plan(dataset, garment_names(manifest, designs, seeds), config.rays, templates)
    # One core each: the solver's arrays are too small to share a thread pool, two processes are twice as fast.
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    context = multiprocessing.get_context("spawn")
    failed: list[str] = []
    with ProcessPoolExecutor(config.processes, mp_context=context, initializer=end_with_parent) as pool:
        try:
            for name, wave in zip(("mean body", "templates", "rays"), waves, strict=True):
                _run_wave(pool, root, name, wave, failed)
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            raise
    if failed:
        raise RuntimeError(f"{len(failed)} tasks failed, the first: {failed[0]}")


def _run_wave(pool: ProcessPoolExecutor, root: Path, name: str, wave: list[Task], failed: list[str]) -> None:
    missing = [task for task in wave if not task.path(root).exists()]
    with tqdm(total=len(wave), initial=len(wave) - len(missing), desc=name, unit="file", mininterval=2) as bar:
        futures = {pool.submit(run_task, str(root), task): task for task in missing}
        for future in as_completed(futures):
            bar.update()
            error = future.exception()
            if error is None:
                bar.set_postfix_str(future.result()[:90])
            else:
                task = futures[future]
                failed.append(f"{task}: {error}")
                tqdm.write(f"failed: {failed[-1]}")
