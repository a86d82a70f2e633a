"""Beyond the paper: learned drapes as the start of the simulator, and what its steps buy."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments.shared.evaluate import Pipeline, available, held_out_rows, load_all, open_model
from experiments.shared.record import RESULTS, publish
from experiments.shared.refined import stored_pattern
from tryon_jax.checks import check_range
from tryon_jax.files.atomic import atomic_path
from tryon_jax.garment import load_manifest, remesh
from tryon_jax.garment.placement import placement
from tryon_jax.metrics import fine_part, vertex_distances
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import config_space
from tryon_jax.wear.simulate import Simulator

TO_REST = 0
"""Stands for as many steps as it takes to come to rest."""


@dataclass(frozen=True)
class Config:
    """What to compare."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    steps: tuple[int, ...] = (5, 20, TO_REST)
    """Solver steps after the learned drape; 0 brings it to rest."""
    shapes: int = 2
    """Test shapes of each unseen design, evenly spread."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Refine learned drapes of unseen designs on unseen bodies and measure them against both ways to simulate."""
    check_range("shapes", config.shapes, 1, 1000)
    manifest = load_manifest()
    fabrics = tuple(read_config(config.data).fabrics)
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, fabrics)
    names = available(config.data, [f"{d.label}-{s}" for d in manifest.unseen for s in manifest.training_seeds])
    if not names:
        raise ValueError("no unseen design is simulated (`simulate --part unseen`)")
    pipeline, simulator = Pipeline(model), Simulator(model.body)
    samples = load_all(model, config.data, names)
    entries = []
    for name, one in tqdm(samples.items(), desc="designs", mininterval=2):
        rows = held_out_rows(one, fabrics, config.shapes)
        predicted = pipeline(one, rows, fabrics)
        pattern = stored_pattern(config.data, name)
        design = manifest.design(one.label)
        mesh = remesh(config_space(model.config), design, model.config.target_area, seed=one.seed)
        if mesh.num_vertices != one.garment.num_vertices:
            raise ValueError(f"{name}: the mesh of the dataset was made by another version of this library")
        panels = placement(mesh).astype(np.float32)
        for fabric in fabrics:
            cloth = load_fabric(fabric)
            for k, row in enumerate(rows):
                betas = one.betas[row]
                anew, seconds = timed(simulator.dress, panels, pattern, cloth, betas)
                truth = {"dataset": one.drapes[fabric][row, : mesh.num_vertices], "anew": anew.vertices}
                drape = predicted[fabric].fine[k]
                drapes = {-1: (drape, 0.0, np.nan, 0)}
                for steps in config.steps:
                    found, took = timed(simulator.refine, drape, pattern, cloth, betas, steps or None)
                    drapes[steps] = (found.vertices, took, found.residual, found.steps)
                for steps, (vertices, took, residual, taken) in drapes.items():
                    entries.append(
                        {"garment": name, "fabric": fabric, "betas": betas.tolist(), "steps": steps, "taken": taken}
                        | {"seconds": took, "residual": residual, "anew_seconds": seconds}
                        | compare(one, vertices, truth)
                    )
    results = {"designs": len(names), "entries": entries}
    publish(config, "refine", results, markdown, draw, garments=names, weights=weights)


def timed(function: Any, *arguments: Any) -> tuple[Any, float]:
    """What a call returns, and its processor time in a second run, so that nothing is compiled in it."""
    function(*arguments)
    began = time.process_time()
    result = function(*arguments)
    return result, time.process_time() - began


def compare(samples: SimulatedGarment, vertices: np.ndarray, truth: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Distances of a drape from the simulations, millimetres, and the energy of its fine part over theirs."""
    padded = np.zeros((1 + len(truth), samples.garment.graph.num_nodes, 3), np.float32)
    for place, drape in zip(padded, [vertices, *truth.values()], strict=True):
        place[: len(drape)] = drape
    fine = fine_part(samples.garment.smoother, padded)[:, : len(vertices)]
    energies = (fine.astype(np.float64) ** 2).sum(-1).mean(axis=1)
    result = {}
    for k, (name, drape) in enumerate(truth.items()):
        result[f"{name}_mm"] = 1e3 * float(vertex_distances(vertices[None], drape[None]).mean())
        result[f"{name}_folds"] = float(energies[0] / energies[1 + k])
    return result


def table(results: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Means over designs and bodies for each fabric and number of steps."""
    keys = sorted({(e["fabric"], e["steps"]) for e in results["entries"]}, key=lambda k: (k[0], _order(k[1])))
    rows = []
    for fabric, steps in keys:
        of = [e for e in results["entries"] if (e["fabric"], e["steps"]) == (fabric, steps)]
        means = {
            key: float(np.mean([e[key] for e in of]))
            for key in ("dataset_mm", "dataset_folds", "anew_mm", "anew_folds", "seconds", "taken", "anew_seconds")
        }
        rows.append({"fabric": fabric, "steps": steps, "drapes": len(of), **means})
    return rows


def markdown(results: Mapping[str, Any]) -> list[str]:
    """The table."""
    rows = table(results)
    lines = [
        f"{results['designs']} unseen designs on unseen bodies, {rows[0]['drapes']} drapes in each fabric. The data "
        "set holds each drape by its convention, from one reference; *dressed anew* is the garment put on the mean "
        "body and carried to this one by itself: another of the equilibria that the cloth has. Folds: energy of what "
        "smoothing takes away, over that of the simulation. Processor seconds, nothing compiled in them.",
        "",
        "| fabric | solver steps | mm from the data set | folds | mm from dressed anew | folds | seconds | "
        "seconds to dress anew |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        steps = {-1: "none: the learned drape", TO_REST: f"to rest ({row['taken']:.0f})"}.get(
            row["steps"], row["steps"]
        )
        lines.append(
            f"| {row['fabric']} | {steps} | {row['dataset_mm']:.2f} | {row['dataset_folds']:.2f} | "
            f"{row['anew_mm']:.2f} | {row['anew_folds']:.2f} | {row['seconds']:.2f} | {row['anew_seconds']:.1f} |"
        )
    return lines


def draw(path: Path, results: Mapping[str, Any]) -> None:
    """Energy of the folds and distance from the data set over the steps."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 2.8), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    rows = table(results)
    for fabric in dict.fromkeys(row["fabric"] for row in rows):
        of = [row for row in rows if row["fabric"] == fabric]
        steps = [row["taken"] for row in of]
        left.plot(steps, [row["dataset_folds"] for row in of], "o-", label=fabric)
        right.plot(steps, [row["dataset_mm"] for row in of], "o-", label=fabric)
    left.axhline(1.0, color="0.4", linewidth=1, linestyle=":")
    left.set_ylabel("energy of folds ÷ simulated")
    right.set_ylabel("mm from the data set")
    for axis in (left, right):
        axis.set_xlabel("solver steps")
        axis.set_ylim(bottom=0)
        axis.spines[["top", "right"]].set_visible(False)
    left.legend(fontsize=8)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)


def _order(steps: int) -> float:
    return np.inf if steps == TO_REST else steps
