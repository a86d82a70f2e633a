"""A grid of unseen garments on unseen bodies, rendered: what the pipeline does where there is no ground truth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from experiments.shared.evaluate import body_vertices, open_model
from experiments.shared.figures import dressed_cell
from experiments.shared.record import RESULTS, publish
from tryon_jax.contact.skin import Skin
from tryon_jax.garment import remesh
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.metrics import area_strain, self_intersecting_share
from tryon_jax.render import contact_sheet
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import config_space, drape, prepare_mesh

COLORS = (
    (0.29, 0.43, 0.58),
    (0.72, 0.42, 0.38),
    (0.42, 0.52, 0.38),
    (0.58, 0.44, 0.62),
    (0.74, 0.60, 0.36),
    (0.36, 0.40, 0.46),
)
"""One colour for each design."""


@dataclass(frozen=True)
class Config:
    """What to draw."""

    run: Path = Path("runs/small")
    """Folder of the run."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    designs: tuple[str, ...] = ("unseen-tank", "unseen-tshirt", "unseen-longsleeve", "unseen-dress")
    """Designs of the manifest that no training has seen, one row each."""
    betas: tuple[tuple[float, float], ...] = ((-2.2, 0.4), (-0.9, -1.3), (0.3, 0.3), (1.1, 1.4), (2.3, -0.6))
    """Body shapes, one column each; off the rays that were simulated."""
    fabric: str = "gray-interlock"
    """Fabric."""
    seed: int = 555
    """Seed of the topologies; not among those trained on."""
    height: int = 300
    """Pixels of one cell."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Drape, draw and count what is wrong."""
    manifest = load_manifest()
    if config.seed in manifest.training_seeds:
        raise ValueError(f"seed {config.seed} is a training topology")
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, (config.fabric,))
    run = jax.jit(drape, static_argnames="fabric")
    betas = np.array(config.betas, np.float32)
    bodies = body_vertices(model, betas)
    space = config_space(model.config)
    items, rows = [], []
    for label, color in zip(config.designs, COLORS, strict=False):
        design = next(d for d in manifest.unseen if d.label == manifest.design(label).label)
        mesh = remesh(space, design, manifest.target_area, seed=config.seed)
        garment = prepare_mesh(model, mesh)
        vertices = garment.unpad(run(model, garment, betas, fabric=config.fabric))
        faces = garment.faces
        for k, shape in enumerate(betas):
            title = f"{label.removeprefix('unseen-')} · betas {shape[0]:g}, {shape[1]:g}"
            items.append(dressed_cell(model.body, bodies[k], (vertices[k], faces), title, color))
            found = Skin.of_shape(model.body, shape).penetration(vertices[k], faces)
            strain = area_strain(vertices[k], faces, mesh.uv, mesh.faces_uv)
            rows.append(
                {
                    "design": label,
                    "betas": shape,
                    "inside_percent": 100 * found.vertices,
                    "deepest_mm": 1e3 * found.depth,
                    "self_intersecting_percent": 100 * self_intersecting_share(vertices[k], faces),
                    "area_strain_percent": 100 * float(strain.mean()),
                }
            )
    results = {"fabric": config.fabric, "drapes": rows}
    publish(config, "qualitative", results, markdown, weights=weights)
    contact_sheet(config.out / "qualitative.jpg", items, columns=len(betas), height=config.height)
    print(f"wrote {config.out / 'qualitative.jpg'}")


def markdown(results: dict[str, Any]) -> list[str]:
    """Averages over the bodies of each design."""
    lines = [
        "| unseen design, unseen topology, unseen bodies | vertices inside, % | deepest, mm | "
        "self-intersecting faces, % | mean area strain, % |",
        "|---|---|---|---|---|",
    ]
    for label in dict.fromkeys(row["design"] for row in results["drapes"]):
        chosen = [row for row in results["drapes"] if row["design"] == label]
        inside, crossing, strain = (
            float(np.mean([row[key] for row in chosen]))
            for key in ("inside_percent", "self_intersecting_percent", "area_strain_percent")
        )
        deepest = max(row["deepest_mm"] for row in chosen)
        lines.append(f"| {label} | {inside:.2f} | {deepest:.1f} | {crossing:.2f} | {strain:+.1f} |")
    return lines
