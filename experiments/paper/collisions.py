"""Vertices inside the body before and after the self-supervised collision step, kept clear, and pushed out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from experiments.shared.evaluate import Pipeline, body_vertices, case_names, held_out_rows, load_all, open_model
from experiments.shared.record import RESULTS, publish
from tryon_jax.contact.push_out import push_out
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.contact.skin import Skin
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.metrics import vertex_distances
from tryon_jax.nets.store import read_record
from tryon_jax.training.collisions import make_pool, random_betas
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.run_folder import chain, model_path
from tryon_jax.tryon import TryOnModel, drape

PAPER_CHANGE = {"training": -70.0, "held_out": -20.0}
"""Change of the vertices inside, percent, that the paper reports."""
RANDOM_SEED = 20_000
"""Of random garments and bodies that no collision step has seen."""


@dataclass(frozen=True)
class Config:
    """What to measure."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run."""
    before: Path | None = None
    """Model file from before the collision step, to be measured beside the run's."""
    out: Path = RESULTS
    """Folder for the record."""
    shapes: int = 4
    """Test shapes of each garment."""
    garments: int = 6
    """Garments of each case, evenly spread; 0 for all."""
    random: int = 64
    """Garments of random design and topology."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Read what the collision step recorded, and measure the model as it is by signed distance."""
    weights = model_path(config.run)
    fabrics = read_config(config.data).fabrics
    training = read_record(weights).get("training", {})
    steps = {f: training[f"collisions-{f}"] for f in fabrics if f"collisions-{f}" in training}
    model = open_model(weights, config.untrained, fabrics)
    cases = case_names(config.data, load_manifest(), config.garments)
    names = [name for group in cases.values() for name in group]
    garments = load_all(model, config.data, names)
    alone = replace(model, skin=None)
    results = {
        "collision_step": steps,
        "measured": measure(model, garments, cases, fabrics, config.shapes, pushed=True),
        "measured_alone": measure(alone, garments, cases, fabrics, config.shapes),
        "random": {_ALONE: random_garments(alone, fabrics, config.random, config.shapes)},
    }
    if config.before is not None:
        before = replace(open_model(config.before, config.untrained, fabrics), skin=None)
        results["measured_before"] = measure(before, garments, cases, fabrics, config.shapes)
        results["random"] = {
            _BEFORE: random_garments(before, fabrics, config.random, config.shapes),
            **results["random"],
        }
    if model.skin is not None:
        results["random"][_CLEAR] = random_garments(model, fabrics, config.random, config.shapes)
    publish(config, "collisions", results, markdown, garments=names, weights=weights)


_BEFORE, _ALONE = "before the collision step", "the networks alone"
_CLEAR = "as `drape` gives it, kept clear of the skin"


def random_garments(model: TryOnModel, fabrics: Sequence[str], count: int, shapes: int) -> dict[str, dict[str, float]]:
    """Exact share and depth of the vertices inside, for random garments on random bodies, by fabric."""
    run, rng = jax.jit(drape, static_argnames="fabric"), np.random.default_rng(RANDOM_SEED)
    found: dict[str, list[tuple[float, float]]] = {fabric: [] for fabric in fabrics}
    for pooled in make_pool(model, count, RANDOM_SEED):
        garment = pooled.garment
        betas = random_betas(rng, shapes, model.config.beta_ranges)
        skins = [Skin.of_shape(model.body, row) for row in betas]
        for fabric in fabrics:
            for skin, vertices in zip(skins, garment.unpad(run(model, garment, betas, fabric=fabric)), strict=True):
                distance = skin.signed_distances(vertices)
                found[fabric].append((float((distance < 0).mean()), max(0.0, -float(distance.min()))))
    return {
        fabric: {
            "drapes": len(rows),
            "vertices_percent": 100 * float(np.mean([share for share, _ in rows])),
            "mean_deepest_mm": 1e3 * float(np.mean([depth for _, depth in rows])),
        }
        for fabric, rows in found.items()
        if rows
    }


def measure(
    model: TryOnModel,
    garments: Mapping[str, SimulatedGarment],
    cases: Mapping[str, Sequence[str]],
    fabrics: Sequence[str],
    shapes: int,
    pushed: bool = False,
) -> dict[str, Any]:
    """Penetration by signed distance and error over test shapes of each case; `pushed`: after the push-out as well."""
    pipeline = Pipeline(model)
    measured: dict[str, Any] = {}
    for case, group in cases.items():
        found: list[tuple[float, ...]] = []
        out: list[tuple[float, ...]] = []
        for name in tqdm(group, desc=case, mininterval=2):
            samples = garments[name]
            rows = held_out_rows(samples, fabrics, shapes)
            if not len(rows):
                # Too tight for any of these bodies.
                continue
            count, faces = samples.garment.num_vertices, samples.garment.faces
            shaped = body_vertices(model, samples.betas[rows])
            for fabric, predicted in pipeline(samples, rows, fabrics).items():
                for k, row in enumerate(rows):
                    body = Skin.of_shape(model.body, samples.betas[row])
                    simulated = samples.drapes[fabric][row, :count]
                    here = body.penetration(predicted.fine[k], faces)
                    there = body.penetration(simulated, faces)
                    error = 1e3 * float(vertex_distances(predicted.fine[k], simulated).mean())
                    found.append((here.vertices, here.surface, here.depth, there.vertices, error))
                    if pushed:
                        surface = ClosedSurface(shaped[k], np.asarray(model.body.faces))
                        moved = push_out(predicted.fine[k], faces, surface)
                        after = 1e3 * float(vertex_distances(moved.vertices, simulated).mean())
                        out.append((moved.inside, moved.largest_move, after))
        if found:
            table = np.array(found)
            measured[case] = {
                "samples": len(found),
                "vertices_percent": 100 * table[:, 0].mean(),
                "surface_percent": 100 * table[:, 1].mean(),
                "mean_deepest_mm": 1e3 * table[:, 2].mean(),
                "deepest_mm": 1e3 * table[:, 2].max(),
                "simulation_vertices_percent": 100 * table[:, 3].mean(),
                "error_mm": table[:, 4].mean(),
            }
        if out:
            table = np.array(out)
            measured[case] |= {
                "pushed_out_inside_percent": 100 * table[:, 0].max(),
                "pushed_out_largest_move_mm": 1e3 * table[:, 1].mean(),
                "pushed_out_error_mm": table[:, 2].mean(),
            }
    return measured


def markdown(results: dict[str, Any]) -> list[str]:
    """Tables with the paper's numbers beside ours."""
    lines = []
    if results["collision_step"]:
        lines += [
            "| collision step, random bodies and garments | vertices inside before, % | after, % | change | paper |",
            "|---|---|---|---|---|",
        ]
        for fabric, record in results["collision_step"].items():
            for split, paper in PAPER_CHANGE.items():
                # A step may continue another.
                steps = chain(record)
                (before, _), (_, after) = (step[f"inside_{split}_percent"] for step in (steps[0], steps[-1]))
                change = f"{100 * (after / before - 1):+.0f} %" if before else "–"
                title = f"{fabric}, {'training' if split == 'training' else 'unseen'} garments"
                lines.append(f"| {title} | {before:.3f} | {after:.3f} | {change} | {paper:+.0f} % |")
        lines.append("")
    else:
        lines += ["The collision step has not been run on these weights: not measured.", ""]
    lines += [
        "| test shapes | vertices inside, % | surface inside, % | deepest, mm (mean · worst) | "
        "simulation, vertices inside, % | error, mm |",
        "|---|---|---|---|---|---|",
    ]
    tables = {
        "before the collision step": results.get("measured_before", {}),
        "the networks alone": results.get("measured_alone", {}),
        "as `drape` gives it": results["measured"],
    }
    for when, table in tables.items():
        for case, row in table.items():
            lines.append(
                f"| {case} ({row['samples']} drapes), {when} | {row['vertices_percent']:.2f} | "
                f"{row['surface_percent']:.2f} | {row['mean_deepest_mm']:.1f} · {row['deepest_mm']:.1f} | "
                f"{row['simulation_vertices_percent']:.2f} | {row['error_mm']:.2f} |"
            )
    lines += ["", *_random(results.get("random", {})), *_pushed_out(results["measured"])]
    return lines


def _random(results: Mapping[str, Mapping[str, Mapping[str, float]]]) -> list[str]:
    fabrics = list(dict.fromkeys(fabric for rows in results.values() for fabric in rows))
    if not fabrics:
        return []
    lines = [
        "| random garments on random bodies, exact | "
        + " | ".join(f"{fabric}: vertices inside, % · deepest, mean, mm" for fabric in fabrics)
        + " |",
        "|---" * (1 + len(fabrics)) + "|",
    ]
    for when, rows in results.items():
        cells = [f"{rows[f]['vertices_percent']:.4f} · {rows[f]['mean_deepest_mm']:.2f}" for f in fabrics]
        lines.append(f"| {when} ({rows[fabrics[0]]['drapes']} drapes) | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _pushed_out(measured: Mapping[str, Any]) -> list[str]:
    rows = {case: row for case, row in measured.items() if "pushed_out_error_mm" in row}
    if not rows:
        return []
    lines = [
        "| after the push-out | samples inside in the worst drape, % | largest move, mean, mm | error, mm |",
        "|---|---|---|---|",
    ]
    return lines + [
        f"| {case} | {row['pushed_out_inside_percent']:.3f} | {row['pushed_out_largest_move_mm']:.1f} | "
        f"{row['pushed_out_error_mm']:.2f} |"
        for case, row in rows.items()
    ]
