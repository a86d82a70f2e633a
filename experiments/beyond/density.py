"""Beyond the paper: one garment meshed at half to eight times the density that the networks were trained at."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from experiments.shared.evaluate import Stack, available, open_model, spread
from experiments.shared.neighbours import load_drapes
from experiments.shared.record import RESULTS, publish
from tryon_jax.files.atomic import atomic_path
from tryon_jax.garment import GarmentMesh, place_on_template, remesh
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.garment.pattern_map import map_patterns, pattern_arrays
from tryon_jax.metrics import hausdorff_distance, vertex_distances
from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.training.dataset import default_root, load_arrays, mesh_path
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import TryOnModel, config_space, drape, prepare_mesh

CLAIM = 1.25
"""Error at another density over that at the trained one that counts as holding."""
WAYS = {
    "direct": "the networks see the mesh itself",
    "carried": "as users get it: a mesh of trained density carries it (`prepare(target_area=…)`)",
}


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
    """Design of the manifest, simulated at the trained density."""
    fabric: str = "gray-interlock"
    """Fabric."""
    factors: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0)
    """Vertices over those at the trained density; 1 must be among them."""
    seed: int = 300
    """Seed of the topologies; not among those trained on."""
    shapes: int = 12
    """Test shapes, evenly spread; 0 for all."""
    hausdorff_shapes: int = 3
    """Of those, how many are also measured surface to surface."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Drape each density in both ways and measure it against the simulation and against the trained density."""
    if 1.0 not in config.factors:
        raise ValueError(f"factors must have 1, the trained density, among them; got {config.factors}")
    manifest = load_manifest()
    if config.seed in manifest.training_seeds:
        raise ValueError(f"seed {config.seed} is a training topology")
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, (config.fabric,))
    design = manifest.design(config.design)
    name = next(iter(available(config.data, [f"{design.label}-{s}" for s in manifest.training_seeds])), None)
    if name is None:
        raise ValueError(f"{design.label!r} is not simulated")
    simulated = load_drapes(model, config.data, name, config.fabric)
    rows = np.flatnonzero(simulated.good & simulated.test)
    rows = rows[spread(len(rows), config.shapes)]
    truth, stored = simulated.vertices[rows], load_arrays(mesh_path(config.data, name))
    space = config_space(model.config)
    meshes = {
        factor: remesh(space, design, model.config.target_area / factor, seed=config.seed) for factor in config.factors
    }
    drapes: dict[str, dict[float, Stack]] = {way: {} for way in WAYS}
    for factor in tqdm(sorted(meshes, key=lambda f: f != 1.0), desc="densities", mininterval=2):
        for way in WAYS:
            drapes[way][factor] = _drape(model, meshes[factor], way, simulated.betas[rows], config.fabric)
    own = pattern_arrays(meshes[1.0])
    entries = []
    looked_at = spread(len(rows), config.hausdorff_shapes)
    for way, by_factor in drapes.items():
        for factor in config.factors:
            mesh, found = meshes[factor], by_factor[factor]
            onto_truth = map_patterns(pattern_arrays(mesh), stored)(truth)
            onto_own = map_patterns(pattern_arrays(mesh), own)(drapes["direct"][1.0])
            entries.append(
                {
                    "way": way,
                    "factor": factor,
                    "vertices": mesh.num_vertices,
                    "simulation_mm": 1e3 * float(vertex_distances(found, onto_truth).mean()),
                    "trained_density_mm": 1e3 * float(vertex_distances(found, onto_own).mean()),
                    "hausdorff_mm": float(
                        np.mean(
                            [
                                1e3 * hausdorff_distance(found[k], mesh.faces, truth[k], stored["faces"])
                                for k in looked_at
                            ]
                        )
                    ),
                }
            )
    results = {"design": design.label, "fabric": config.fabric, "shapes": len(rows), "entries": entries}
    publish(config, "density", results, markdown, draw, garments=[name], weights=weights)


def _drape(model: TryOnModel, mesh: GarmentMesh, way: str, betas: np.ndarray, fabric: str) -> Stack:
    seen = None
    if way == "direct":
        template = np.asarray(apply_mean_drape(model.mean, jnp.asarray(mesh.design.values, jnp.float32)))
        seen = place_on_template(mesh, template)
    garment = prepare_mesh(model, mesh, vertices=seen)
    # One shape at a time: the largest meshes would need gigabytes for all of them.
    return np.stack([garment.unpad(_run(model, garment, beta, fabric=fabric)) for beta in betas])


_run = jax.jit(drape, static_argnames="fabric")


def ratios(results: Mapping[str, Any], way: str) -> dict[float, float]:
    """Error at each density over the error at the trained one."""
    errors = {e["factor"]: e["simulation_mm"] for e in results["entries"] if e["way"] == way}
    return {factor: error / errors[1.0] for factor, error in errors.items()}


def markdown(results: Mapping[str, Any]) -> list[str]:
    """The table with a verdict for each way."""
    lines = [
        f"{results['design']} in {results['fabric']}, {results['shapes']} test shapes; a topology of its own at each "
        "density, distances at its vertices, the simulation carried over in UV from its own mesh at trained density.",
        "",
        "| how | vertices ÷ trained | vertices | from the simulation, mm | ÷ the error at trained density | "
        "from the drape at trained density, mm | Hausdorff to the simulation, mm |",
        "|---|---|---|---|---|---|---|",
    ]
    for entry in results["entries"]:
        ratio = ratios(results, entry["way"])[entry["factor"]]
        lines.append(
            f"| {WAYS[entry['way']]} | {entry['factor']:g} | {entry['vertices']} | {entry['simulation_mm']:.2f} | "
            f"{ratio:.2f} | {entry['trained_density_mm']:.2f} | {entry['hausdorff_mm']:.1f} |"
        )
    for way, title in WAYS.items():
        found = ratios(results, way)
        worst = max(found, key=lambda factor: found[factor])
        word = "supported" if found[worst] <= CLAIM else "not supported"
        lines += ["", f"Within {CLAIM:g} × of the error at trained density, when {title}: {word} "]
        lines[-1] += f"(worst {found[worst]:.2f} at {worst:g} ×)."
    return lines


def draw(path: Path, results: Mapping[str, Any]) -> None:
    """Error over density, both ways, with the limit of the claim."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2, 3.4), dpi=110, layout="constrained")
    axis = figure.subplots()
    for way, style in zip(WAYS, ("o--", "s-"), strict=True):
        entries = sorted((e for e in results["entries"] if e["way"] == way), key=lambda e: e["factor"])
        label = "networks on the mesh itself" if way == "direct" else "carried by a copy at trained density"
        axis.plot([e["factor"] for e in entries], [e["simulation_mm"] for e in entries], style, label=label)
    factors = sorted({e["factor"] for e in results["entries"]})
    trained = next(e["simulation_mm"] for e in results["entries"] if e["factor"] == 1.0)
    axis.axhline(CLAIM * trained, color="0.4", linewidth=1, linestyle=":", label=f"{CLAIM:g} × the error at 1 ×")
    axis.set_xscale("log", base=2)
    axis.set_xticks(factors, [f"{factor:g} ×" for factor in factors])
    axis.set_ylim(bottom=0)
    axis.set_xlabel("vertices ÷ those trained at")
    axis.set_ylabel("mm from the simulation")
    axis.legend(fontsize=8, loc="lower right")
    axis.spines[["top", "right"]].set_visible(False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
