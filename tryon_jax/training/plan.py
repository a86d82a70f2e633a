"""What there is to simulate: a list of independent tasks, each of which writes one file of the dataset."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from tryon_jax.garment import Design
from tryon_jax.garment.manifest import Manifest
from tryon_jax.training.dataset import DatasetConfig, mean_path, ray_path, template_path
from tryon_jax.training.protocol import make_protocol

TEMPLATE_SEED = 7
"""Seed of the Sobol sequence of designs for R_mean."""


@dataclass(frozen=True)
class Task:
    """One file of the dataset: kind is "mean", "ray" or "template"."""

    kind: str
    garment: str = ""
    fabric: str = ""
    number: int = 0
    """Ray, or number of the template design."""

    def path(self, root: Path) -> Path:
        """The file that this task writes."""
        if self.kind == "mean":
            return mean_path(root, self.garment, self.fabric)
        if self.kind == "ray":
            return ray_path(root, self.garment, self.fabric, self.number)
        return template_path(root, self.number)


def plan(config: DatasetConfig, garments: Sequence[str], rays: int, templates: int) -> list[list[Task]]:
    """Tasks in waves: drapes on the mean body, then templates and rays, which read or start from those drapes.

    Rays come in the protocol's order over all garments, so that any beginning of the list covers everything evenly.
    """
    protocol = make_protocol(config.num_betas)
    means = [Task("mean", garment, fabric) for garment in garments for fabric in config.fabrics]
    return [
        means,
        [Task("template", number=k) for k in range(templates)],
        [replace(task, kind="ray", number=ray) for ray in protocol.order[:rays] for task in means],
    ]


def batches(tasks: Sequence[Task], size: int) -> list[tuple[Task, ...]]:
    """The tasks of one wave in groups of at most `size` for `generate.run_batch`; rays of one garment stay together."""
    garments = list(dict.fromkeys(task.garment for task in tasks)) if tasks and tasks[0].kind == "ray" else [""]
    groups = [[task for task in tasks if not name or task.garment == name] for name in garments]
    return [tuple(group[k : k + size]) for group in groups for k in range(0, len(group), size)]


def template_designs(manifest: Manifest, count: int) -> list[Design]:
    """Designs for R_mean: the training designs, then a Sobol sequence over the whole space."""
    designs = list(manifest.training)
    space = manifest.space
    extra = max(0, count - len(designs))
    if extra:
        sobol = qmc.Sobol(len(space.names), seed=TEMPLATE_SEED)
        unit = sobol.random_base2(max(1, int(np.ceil(np.log2(extra)))))[:extra]
        for k, row in enumerate(unit):
            values = space.minimum + row * (space.maximum - space.minimum)
            designs.append(space.design(f"sobol-{k}", **dict(zip(space.names, map(float, values), strict=True))))
    return designs[:count]


def garment_names(manifest: Manifest, designs: Sequence[str], seeds: Sequence[int]) -> list[str]:
    """Names of garments, design-major; every design is checked against the manifest."""
    return [f"{manifest.design(label).label}-{seed}" for label in designs for seed in seeds]
