"""The tasks of a simulation: independent of each other, each of which writes one file of the dataset."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tryon_jax.garment.manifest import Manifest
from tryon_jax.training.dataset import DatasetConfig, mean_path, ray_path, reference_path, template_path
from tryon_jax.training.protocol import Protocol, make_protocol


@dataclass(frozen=True)
class Task:
    """One file of the dataset: kind is "reference", "mean", "template" or "ray"."""

    kind: str
    garment: str = ""
    fabric: str = ""
    number: int = 0
    """Of the ray."""
    training_only: bool = False
    """The ray's test shapes are left out: nothing is tested on this garment."""

    def path(self, root: Path) -> Path:
        """The file that this task writes."""
        if self.kind == "reference":
            return reference_path(root, self.fabric)
        if self.kind == "mean":
            return mean_path(root, self.garment, self.fabric)
        if self.kind == "ray":
            return ray_path(root, self.garment, self.fabric, self.number)
        return template_path(root, self.garment.rsplit("-", 1)[0])


def plan(
    config: DatasetConfig, manifest: Manifest, garments: Sequence[str], rays: int, *, additional: bool = False
) -> list[tuple[str, list[Task]]]:
    """Tasks in waves, each with its title: drapes come after those that they start from.

    Rays come in the protocol's order over all garments, so that any beginning of the list covers everything evenly.

    Args:
        config: Of the dataset.
        manifest: Designs and topologies.
        garments: Names of garments.
        rays: Rays of body shapes for each garment.
        additional: The garments are additional designs: each has rays of its own, spread evenly and turned from design
            to design, without the test shapes.
    """
    protocol = make_protocol(config.num_betas)
    first = [name for name in garments if manifest.first_topology(name) == name]
    later = [name for name in garments if name not in set(first)]
    trained = [name for name in first if manifest.split(*split_name(name)) == "training"]

    def means(names: Sequence[str]) -> list[Task]:
        return [Task("mean", garment, fabric) for garment in names for fabric in config.fabrics]

    def sweeps(names: Sequence[str]) -> list[Task]:
        numbers = {name: ray_numbers(protocol, rays, garments.index(name) if additional else None) for name in names}
        return [
            Task("ray", garment, fabric, numbers[garment][k], additional)
            for k in range(rays)
            for garment in names
            for fabric in config.fabrics
        ]

    reference = [Task("reference", fabric=fabric) for fabric in config.fabrics]
    return [
        ("reference", reference if config.convention == "reference" else []),
        ("mean body", means(first)),
        ("mean body, other topologies", means(later)),
        ("templates", [Task("template", garment) for garment in trained]),
        ("rays", sweeps(first)),
        ("rays, other topologies", sweeps(later)),
    ]


def ray_numbers(protocol: Protocol, count: int, turn: int | None) -> list[int]:
    """Numbers of `count` rays: the first of the protocol's order, or evenly spaced ones from number `turn` on.

    Args:
        protocol: Which rays there are, in which order.
        count: How many are wanted.
        turn: Number of the first of evenly spaced rays; None for the first of the protocol's order.
    """
    if turn is None:
        return list(protocol.order[:count])
    total = len(protocol.rays)
    return [(turn + k * total // count) % total for k in range(count)]


def split_name(garment: str) -> tuple[str, int]:
    """Design label and topology seed of a garment's name."""
    label, seed = garment.rsplit("-", 1)
    return label, int(seed)


def batches(tasks: Sequence[Task], size: int) -> list[tuple[Task, ...]]:
    """The tasks of one wave in groups of at most `size` for `generate.run_batch`; rays of one garment stay together."""
    garments = list(dict.fromkeys(task.garment for task in tasks)) if tasks and tasks[0].kind == "ray" else [""]
    groups = [[task for task in tasks if not name or task.garment == name] for name in garments]
    return [tuple(group[k : k + size]) for group in groups for k in range(0, len(group), size)]


def garment_names(manifest: Manifest, designs: Sequence[str], seeds: Sequence[int]) -> list[str]:
    """Names of garments, design-major; every design is checked against the manifest.

    Args:
        manifest: Designs and topologies.
        designs: Labels.
        seeds: Of topologies.

    Raises:
        ValueError: There is no such design.
    """
    return [f"{manifest.design(label).label}-{seed}" for label in designs for seed in seeds]
