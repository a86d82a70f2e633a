"""Simulated drapes on other meshes: more topologies to learn from, without another simulation.

A drape is a map from the flat pattern to space, whatever mesh it was computed on. Read at the vertices of a fresh
topology of the same design it teaches the networks that the drape does not depend on the mesh. Fresh topologies have
seeds that no split knows, and a design that is not trained on is not carried.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from tryon_jax.garment import remesh
from tryon_jax.garment.manifest import Manifest
from tryon_jax.garment.pattern_map import map_patterns, pattern_arrays
from tryon_jax.training.drapes import load_mesh
from tryon_jax.training.garments import SimulatedGarment, training_bucket, training_shapes
from tryon_jax.tryon import TryOnModel, config_space, prepare_mesh

FIRST_SEED = 1000
"""Seed of the first fresh topology; all seeds of the manifest are below."""


def fresh_topologies(
    model: TryOnModel, root: Path, samples: Sequence[SimulatedGarment], manifest: Manifest, per_garment: int
) -> list[SimulatedGarment]:
    """`per_garment` fresh topologies of every simulated garment that is fitted, with its drapes carried over.

    Args:
        model: Its configuration and R_mean.
        root: Folder of the dataset.
        samples: Simulated garments.
        manifest: Splits of designs and topologies.
        per_garment: Fresh topologies of each.
    """
    fitted = [s for s in samples if s.label not in manifest.validation]
    count = len(manifest.training_seeds)
    jobs = [
        (s, FIRST_SEED + count * k + manifest.training_seeds.index(s.seed)) for s in fitted for k in range(per_garment)
    ]
    return [
        carry_over(model, root, s, manifest, seed) for s, seed in tqdm(jobs, desc="fresh topologies", mininterval=2)
    ]


def carry_over(
    model: TryOnModel, root: Path, samples: SimulatedGarment, manifest: Manifest, seed: int
) -> SimulatedGarment:
    """The drapes of the training shapes on the topology of another seed.

    Args:
        model: The model that the garment is prepared for.
        root: Folder of the dataset, which holds the mesh of `samples`.
        samples: A simulated garment.
        manifest: Its design and the seeds of the splits.
        seed: Of `remesh`.

    Raises:
        ValueError: the seed belongs to a topology of the splits.
        PermissionError: the simulated garment is for testing.
    """
    if seed in manifest.training_seeds + manifest.test_seeds:
        raise ValueError(f"seed {seed} is a topology of the splits; a fresh one starts at {FIRST_SEED}")
    rows = np.flatnonzero(training_shapes(samples, manifest))
    design = manifest.design(samples.label)
    mesh = remesh(config_space(model.config), design, model.config.target_area, seed=seed)
    onto = map_patterns(pattern_arrays(mesh), load_mesh(root, samples.name))
    garment = prepare_mesh(model, mesh, bucket=training_bucket(mesh.num_vertices))
    size, old = garment.graph.num_nodes, samples.garment.num_vertices

    def carried(values: np.ndarray) -> np.ndarray:
        moved = np.zeros((len(rows), size, 3), np.float32)
        moved[:, : mesh.num_vertices] = onto(values[rows, :old])
        return moved

    return SimulatedGarment(
        f"{samples.label}-{seed}",
        garment,
        samples.betas[rows],
        samples.test[rows],
        {fabric: carried(values) for fabric, values in samples.drapes.items()},
        {fabric: good[rows] for fabric, good in samples.good.items()},
        carried(samples.target),
        samples.usable[rows],
        samples.name,
    )
