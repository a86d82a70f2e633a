"""Topologies unseen in training beside those trained on: Hausdorff distance to the simulation over body shapes."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments.shared.evaluate import Pipeline, available, common_rows, load_all, open_model
from experiments.shared.record import RESULTS, publish
from tryon_jax.files.atomic import atomic_path
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.metrics import hausdorff_distance, vertex_distances
from tryon_jax.training.dataset import default_root
from tryon_jax.training.run_folder import model_path

CLAIM = 1.05
"""Error on unseen topologies over that on trained ones that counts as "on par"."""


@dataclass(frozen=True)
class Config:
    """What to compare."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    design: str = "tshirt"
    """Training design whose topologies are compared."""
    fabric: str = "gray-interlock"
    """Fabric."""
    shapes: int = 0
    """Test shapes, evenly spread, of those that all topologies have; 0 for all."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Measure each topology against its own simulation, and the simulations against each other."""
    manifest = load_manifest()
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, (config.fabric,))
    label = manifest.design(config.design).label
    names = available(config.data, [f"{label}-{s}" for s in manifest.training_seeds + manifest.test_seeds])
    if len(names) < 2:
        raise ValueError(f"too few topologies of {label!r} are simulated: {', '.join(names) or 'none'}")
    garments = load_all(model, config.data, names)
    pipeline, wanted = Pipeline(model), common_rows(garments, [config.fabric], config.shapes)
    if not len(wanted[names[0]]):
        raise ValueError(f"no test shape is simulated for all of {', '.join(names)}")
    first = garments[names[0]]
    topologies = []
    for name in tqdm(names, desc="topologies", mininterval=2):
        samples = garments[name]
        rows = wanted[name]
        count, faces = samples.garment.num_vertices, samples.garment.faces
        predicted = pipeline(samples, rows, [config.fabric])[config.fabric].fine
        simulated = samples.drapes[config.fabric][rows, :count]
        entry: dict[str, Any] = {
            "name": name,
            "split": manifest.split(samples.label, samples.seed),
            "vertices": count,
            "betas": samples.betas[rows],
            "hausdorff_mm": [
                1e3 * hausdorff_distance(p, faces, s, faces) for p, s in zip(predicted, simulated, strict=True)
            ],
            "vertex_mm": 1e3 * vertex_distances(predicted, simulated).mean(axis=1),
        }
        if name != names[0]:
            drapes, own = first.drapes[config.fabric][:, : first.garment.num_vertices], first.garment.faces
            entry["simulations_apart_mm"] = [
                1e3 * hausdorff_distance(s, faces, drapes[k], own)
                for s, beta in zip(simulated, samples.betas[rows], strict=True)
                for k in np.flatnonzero((first.betas == beta).all(axis=1) & first.good[config.fabric])
            ]
        topologies.append(entry)
    results = {"design": label, "fabric": config.fabric, "topologies": topologies, **summarise(topologies)}
    publish(config, "new_topologies", results, markdown, draw, garments=names, weights=weights)


def summarise(topologies: list[dict[str, Any]]) -> dict[str, Any]:
    """Means over shapes and topologies of each split, and whether they are on par."""
    found: dict[str, Any] = {}
    for split, key in (("training", "trained"), ("test", "unseen")):
        chosen = [t for t in topologies if t["split"] == split]
        found[key] = {
            "topologies": len(chosen),
            **{
                measure: float(np.mean([np.mean(t[measure]) for t in chosen])) if chosen else None
                for measure in ("hausdorff_mm", "vertex_mm")
            },
        }
    apart = [np.mean(t["simulations_apart_mm"]) for t in topologies if t.get("simulations_apart_mm")]
    found["simulations_apart_mm"] = float(np.mean(apart)) if apart else None
    trained, unseen = found["trained"]["hausdorff_mm"], found["unseen"]["hausdorff_mm"]
    found["ratio"] = unseen / trained if trained and unseen else None
    return found


def markdown(results: dict[str, Any]) -> list[str]:
    """The table with the claim's verdict."""
    lines = ["| topologies | Hausdorff distance, mm | mean per vertex, mm |", "|---|---|---|"]
    for key in ("trained", "unseen"):
        entry = results[key]
        if entry["topologies"]:
            lines.append(f"| {entry['topologies']} {key} | {entry['hausdorff_mm']:.1f} | {entry['vertex_mm']:.2f} |")
        else:
            lines.append(f"| {key}: none simulated | – | – |")
    if results["simulations_apart_mm"] is not None:
        lines.append(f"| simulations of two topologies, from each other | {results['simulations_apart_mm']:.1f} | – |")
    ratio = results["ratio"]
    if ratio is None:
        verdict = "not measured"
    else:
        verdict = f"{'supported' if ratio <= CLAIM else 'not supported'}: unseen ÷ trained = {ratio:.3f}"
    return [*lines, "", f"Unseen topologies are within {CLAIM - 1:.0%} of trained ones: {verdict}."]


def draw(path: Path, results: dict[str, Any]) -> None:
    """Hausdorff distance over the shapes of each ray, trained topologies dashed (the paper's figure)."""
    from matplotlib.figure import Figure

    shapes = np.concatenate([np.asarray(t["betas"]) for t in results["topologies"]])
    directions = sorted({_direction(beta) for beta in shapes})
    figure = Figure(figsize=(3.6 * len(directions), 3.4), dpi=100, layout="constrained")
    axes = figure.subplots(1, len(directions), sharey=True, squeeze=False)[0]
    for axis, direction in zip(axes, directions, strict=True):
        for entry in results["topologies"]:
            betas, values = np.asarray(entry["betas"]), np.asarray(entry["hausdorff_mm"])
            rows = [k for k, beta in enumerate(betas) if _direction(beta) == direction]
            trained = entry["split"] == "training"
            axis.plot(
                np.linalg.norm(betas[rows], axis=1),
                values[rows],
                "k--" if trained else "-",
                label=f"trained: {entry['name']}" if trained else entry["name"],
                marker=".",
                linewidth=1.4 if trained else 1.0,
                zorder=3 if trained else 2,
            )
        axis.set_title(f"β towards {direction}°", fontsize=9)
        axis.set_xlabel("|β|")
        axis.spines[["top", "right"]].set_visible(False)
    # All axes share it; set before the last curve is drawn it would cut off what comes after.
    axes[0].set_ylim(bottom=0)
    axes[0].set_ylabel("Hausdorff distance, mm")
    axes[0].legend(fontsize=6)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)


def _direction(beta: np.ndarray) -> int:
    second = beta[1] if len(beta) > 1 else 0.0
    return round(float(np.degrees(np.arctan2(second, beta[0])))) % 360
