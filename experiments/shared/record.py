"""Records of experiments: one JSON file with numbers and what they depend on, and the folder of pictures."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from measuring.records import environment, plain
from tryon_jax.files.atomic import write_text
from tryon_jax.nets.store import read_record
from tryon_jax.training.dataset import mean_path, read_config
from tryon_jax.training.training_set import dataset_checksum

RESULTS = Path("docs/results")
"""Folder of the committed records and pictures."""


def describe_dataset(root: Path, names: list[str]) -> dict[str, Any]:
    """Configuration and checksum of the garments that an experiment read."""
    return {"config": asdict(read_config(root)), "garments": len(names), "checksum": dataset_checksum(root, names)}


def describe_model(path: Path) -> dict[str, Any]:
    """Checksum of the weights and the record of their training: which runs saw what."""
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    record = read_record(path)
    return {"sha256": digest, "config": record["config"], "training": record.get("training", {})}


def stages_trained(path: Path, fabrics: tuple[str, ...]) -> list[str]:
    """Stages of a model file that its training record does not list: predictions with them mean nothing."""
    done = read_record(path).get("training", {})
    return [stage for stage in ("mean", "smooth", *(f"fine-{f}" for f in fabrics)) if stage not in done]


def simulated_fabrics(root: Path, name: str) -> list[str]:
    """Fabrics whose drape on the mean body is there for a garment."""
    return [fabric for fabric in read_config(root).fabrics if mean_path(root, name, fabric).exists()]


def write_result(folder: Path, name: str, config: Any, results: Mapping[str, Any], **parts: Any) -> Path:
    """Write FOLDER/name.json: configuration, environment, `parts` (dataset, model) and results."""
    options = {key: value for key, value in asdict(config).items() if not isinstance(value, Path)}
    record = {
        "experiment": name,
        "config": options,
        "environment": environment(),
        **parts,
        "results": results,
    }
    path = folder / f"{name}.json"
    write_text(path, json.dumps(record, indent=1, default=plain) + "\n")
    return path


def publish(
    config: Any,
    name: str,
    results: Mapping[str, Any],
    markdown: Callable[[Any], list[str]],
    draw: Callable[[Path, Any], None] | None = None,
    garments: Iterable[str] | None = None,
    weights: Path | None = None,
) -> None:
    """End an experiment: write its record and its plot to `config.out`, and print what RESULTS.md will say of it.

    Args:
        config: the experiment's options, with `out` and, where there are `garments`, `data`.
        name: the experiment.
        results: its numbers.
        markdown: its section of docs/RESULTS.md.
        draw: its plot, `<name>.png`.
        garments: which garments of the dataset it read.
        weights: which model it measured.
    """
    parts = {}
    if garments is not None:
        parts["dataset"] = describe_dataset(config.data, sorted(garments))
    if weights is not None:
        parts["model"] = describe_model(weights)
    written = [write_result(config.out, name, config, results, **parts)]
    for line in markdown(results):
        print(line)
    if draw is not None:
        written.append(config.out / f"{name}.png")
        draw(written[-1], results)
    print("wrote " + " and ".join(map(str, written)))


def read_result(folder: Path, name: str) -> dict[str, Any] | None:
    """The record of an experiment, or None where it has not been run."""
    path = folder / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
