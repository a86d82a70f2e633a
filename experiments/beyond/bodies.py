"""How many bodies a design needs: errors on other bodies of displacement fields from few simulated drapes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from experiments.shared.evaluate import available, open_model
from experiments.shared.neighbours import Drapes, load_drapes, shape_weights
from experiments.shared.record import RESULTS, publish
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.protocol import EXTENT
from tryon_jax.training.run_folder import model_path


@dataclass(frozen=True)
class Config:
    """What to compare."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run; of its model R_mean alone is used."""
    out: Path = RESULTS
    """Folder for the record."""
    fields: tuple[int, ...] = (4, 8, 16)
    """Numbers of fields K."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Leave out each ray in turn, and measure how well fields of the others' drapes reach it."""
    manifest = load_manifest()
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, ())
    names = available(config.data, [f"{design.label}-{manifest.training_seeds[0]}" for design in manifest.training])
    found: dict[str, list[dict[str, float]]] = {}
    for fabric in read_config(config.data).fabrics:
        for name in tqdm(names, desc=fabric, mininterval=2):
            for key, row in measure(load_drapes(model, config.data, name, fabric), config.fields).items():
                found.setdefault(f"{fabric}: {key}", []).append(row)
    rows = {key: {k: float(np.mean([e[k] for e in entries])) for k in entries[0]} for key, entries in found.items()}
    results = {"designs": len(names), "fields": config.fields, "rows": rows}
    publish(config, "bodies", results, markdown, garments=names, weights=weights)


def rays_of(betas: Float[np.ndarray, "S b"]) -> list[np.ndarray]:
    """Rows of the samples on each ray, from the mean body outwards."""
    scaled = betas / np.array(EXTENT[: betas.shape[1]])[None]
    radius = np.linalg.norm(scaled, axis=1)
    direction = np.round(scaled / np.maximum(radius, 1e-9)[:, None], 3)
    rows = np.flatnonzero(radius > 0)
    _, group = np.unique(direction[rows], axis=0, return_inverse=True)
    return [rows[group == k][np.argsort(radius[rows[group == k]])] for k in range(group.max() + 1)]


def measure(drapes: Drapes, fields: Sequence[int]) -> dict[str, dict[str, float]]:
    """Errors on a ray that was left out, averaged over which, by how many other rays and shapes are seen."""
    rays = [ray[drapes.good[ray]] for ray in rays_of(drapes.betas)]
    rays = [ray for ray in rays if len(ray) >= 4]
    flat = (drapes.vertices - drapes.mean[None]).reshape(len(drapes.vertices), -1)
    origin = np.flatnonzero((drapes.betas == 0).all(axis=1) & drapes.good)
    table: dict[str, list[dict[str, float]]] = {}
    for left_out, test in enumerate(rays):
        others = rays[left_out + 1 :] + rays[:left_out]
        for count in range(1, len(others) + 1):
            for step, word in ((1, "all shapes"), (2, "every second shape")):
                rows = np.concatenate([origin, *(ray[::-1][::step] for ray in others[:count])])
                key = f"{count} rays, {word}"
                table.setdefault(key, []).append(_errors(flat, drapes.betas, rows, test, fields))
    return {key: {k: float(np.mean([e[k] for e in entries])) for k in entries[0]} for key, entries in table.items()}


def _errors(
    flat: Float[np.ndarray, "S D"],
    betas: Float[np.ndarray, "S b"],
    rows: np.ndarray,
    test: np.ndarray,
    fields: Sequence[int],
) -> dict[str, float]:
    """Millimetres from the test drapes: of the best sum of K fields, and with interpolated coefficients."""
    middle = flat[rows].mean(axis=0)
    _, _, modes = np.linalg.svd(flat[rows] - middle, full_matrices=False)
    found = {}
    for count in fields:
        basis = modes[:count]
        best = (flat[test] - middle) @ basis.T
        found[f"best, {count}"] = _distance(middle + best @ basis, flat[test])
    known = (flat[rows] - middle) @ modes[: max(fields)].T
    weights = shape_weights(betas[rows].astype(float), betas[test].astype(float))
    found["interpolated"] = _distance(middle + weights @ known @ modes[: max(fields)], flat[test])
    found["drapes"] = float(len(rows))
    return found


def _distance(one: Float[np.ndarray, "S D"], other: Float[np.ndarray, "S D"]) -> float:
    return 1e3 * float(np.linalg.norm((one - other).reshape(len(one), -1, 3), axis=2).mean())


def markdown(results: Mapping[str, Any]) -> list[str]:
    """One row for each number of rays and shapes."""
    counts = results["fields"]
    lines = [
        f"{results['designs']} training designs, each ray left out in turn: mean distance of its drapes, mm, from the "
        "best sum of K fields of the drapes that are seen, and from the sum whose coefficients are interpolated in the "
        f"betas (K = {max(counts)}).",
        "",
        "| seen | drapes | " + " | ".join(f"best, K = {k}" for k in counts) + " | interpolated |",
        "|---|---|" + "---|" * (len(counts) + 1),
    ]
    for key, row in results["rows"].items():
        cells = " | ".join(f"{row[f'best, {k}']:.2f}" for k in counts)
        lines.append(f"| {key} | {row['drapes']:.0f} | {cells} | {row['interpolated']:.2f} |")
    return lines
