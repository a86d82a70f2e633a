"""Two fabrics on unseen garments and shapes: is each prediction nearest to its own fabric's simulation?"""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments.shared.evaluate import (
    Pipeline,
    body_vertices,
    case_names,
    held_out_rows,
    load_all,
    open_model,
)
from experiments.shared.figures import dressed_cell
from experiments.shared.record import RESULTS, publish
from experiments.shared.refined import Refiner
from tryon_jax.checks import check_range
from tryon_jax.contact.push_out import push_out
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.metrics import fold_statistics, vertex_distances
from tryon_jax.render import contact_sheet
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.run_folder import model_path

COLORS = ((0.30, 0.44, 0.62), (0.80, 0.50, 0.58))
"""Blue and pink, as in the paper's figure."""


@dataclass(frozen=True)
class Config:
    """What to compare."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    shapes: int = 0
    """Test shapes of each garment, evenly spread; 0 for all."""
    garments: int = 0
    """Unseen designs, evenly spread; 0 for all."""
    picture: str = "unseen-tshirt-0"
    """Garment of the picture, where it is simulated."""
    refine: int = 5
    """Steps of the solver after the prediction, as users get it with `--refine 5`: measured and drawn beside it."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Measure all unseen designs and draw one of them."""
    check_range("refine", config.refine, 1, 10_000, "steps")
    fabrics = read_config(config.data).fabrics
    if len(fabrics) != 2:
        raise ValueError(f"this experiment compares two fabrics, the dataset has {len(fabrics)}")
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, fabrics)
    names = case_names(config.data, load_manifest(), config.garments)["unseen design"]
    if not names:
        raise ValueError("no unseen design is simulated: run `python -m experiments simulate --part unseen` first")
    garments = load_all(model, config.data, names)
    pipeline, refiner = Pipeline(model), Refiner(model.body, config.data, config.refine)
    refined_kind = f"after {config.refine} solver steps"
    distances: list[np.ndarray] = []
    differences: list[tuple[float, float, float]] = []
    kinds = [f"{kind} {fabric}" for kind in ("predicted", refined_kind, "simulated") for fabric in fabrics]
    folds: dict[str, list[dict[str, float]]] = {kind: [] for kind in kinds}
    for samples in tqdm(list(garments.values()), desc="garments", mininterval=2):
        rows = held_out_rows(samples, fabrics, config.shapes)
        count, faces = samples.garment.num_vertices, samples.garment.faces
        by_fabric = pipeline(samples, rows, fabrics)
        predicted = np.stack([by_fabric[f].fine for f in fabrics])
        betas = samples.betas[rows]
        refined = np.stack([refiner(samples.name, f, betas, by_fabric[f].fine) for f in fabrics])
        simulated = np.stack([samples.drapes[f][rows, :count] for f in fabrics])
        for k in range(len(rows)):
            apart = [[vertex_distances(p, s).mean() for s in simulated[:, k]] for p in predicted[:, k]]
            distances.append(1e3 * np.array(apart))
            differences.append(_difference(predicted[:, k], simulated[:, k]))
            for kind, drapes in (("predicted", predicted), (refined_kind, refined), ("simulated", simulated)):
                for fabric, drape in zip(fabrics, drapes[:, k], strict=True):
                    folds[f"{kind} {fabric}"].append(asdict(fold_statistics(drape, faces)))
    every = np.array(distances)
    own = every[:, [0, 1], [0, 1]] < every[:, [0, 1], [1, 0]]
    sizes = np.array(differences)
    results: dict[str, Any] = {
        "fabrics": fabrics,
        "samples": len(every),
        "garments": len(garments),
        "distance_mm": every.mean(axis=0),
        "own_nearer_share": own.mean(axis=0),
        "fabrics_apart_mm": {"predicted": float(sizes[:, 0].mean()), "simulated": float(sizes[:, 1].mean())},
        "difference_correlation": float(sizes[:, 2].mean()),
        "folds": {name: {k: float(np.mean([f[k] for f in found])) for k in found[0]} for name, found in folds.items()},
    }
    publish(config, "materials", results, markdown, garments=names, weights=weights)
    shown = garments[config.picture if config.picture in garments else names[0]]
    rows = held_out_rows(shown, fabrics, 0)
    row = rows[[len(rows) // 2]]
    predictions = pipeline(shown, row, fabrics)
    body = body_vertices(model, shown.betas[row])[0]
    count, faces = shown.garment.num_vertices, shown.garment.faces
    predicted = [predictions[f].fine[0] for f in fabrics]
    skin = ClosedSurface(body.astype(np.float64), np.asarray(model.body.faces))
    items = [
        dressed_cell(model.body, body, (drape, faces), f"{kind}: {fabric}", color)
        for kind, drapes in (
            ("predicted", predicted),
            ("as users get it, pushed out", [push_out(drape, faces, skin).vertices for drape in predicted]),
            (refined_kind, [refiner(shown.name, f, shown.betas[row], predictions[f].fine)[0] for f in fabrics]),
            ("simulated", [shown.drapes[f][row[0], :count] for f in fabrics]),
        )
        for fabric, drape, color in zip(fabrics, drapes, COLORS, strict=True)
    ]
    contact_sheet(config.out / "materials.jpg", items, columns=2, crop="garment", height=380)
    print(f"wrote {config.out / 'materials.jpg'}")


def _difference(predicted: np.ndarray, simulated: np.ndarray) -> tuple[float, float, float]:
    """Mean distance between the fabrics, predicted and simulated (mm), and correlation of the two differences."""
    one, other = predicted[1] - predicted[0], simulated[1] - simulated[0]
    norms = float(np.linalg.norm(one)) * float(np.linalg.norm(other))
    means = [1e3 * float(np.linalg.norm(x, axis=-1).mean()) for x in (one, other)]
    return means[0], means[1], float((one * other).sum()) / norms if norms else 0.0


def markdown(results: dict[str, Any]) -> list[str]:
    """Tables with the claim's verdict."""
    fabrics = results["fabrics"]
    matrix, share = np.asarray(results["distance_mm"]), np.asarray(results["own_nearer_share"])
    lines = [
        "| mean distance, mm | " + " | ".join(f"simulated {f}" for f in fabrics) + " | own fabric's is nearer |",
        "|---|" + "---|" * (len(fabrics) + 1),
    ]
    for k, fabric in enumerate(fabrics):
        cells = " | ".join(f"{value:.2f}" for value in matrix[k])
        lines.append(f"| predicted {fabric} | {cells} | {share[k]:.0%} of {results['samples']} drapes |")
    lines += [
        "",
        "| | mean curvature (rms), 1/m | sharp (90th percentile), 1/m | share curved inwards |",
        "|---|---|---|---|",
    ]
    for name, found in results["folds"].items():
        lines.append(f"| {name} | {found['curvature']:.1f} | {found['sharp']:.1f} | {found['concave']:.3f} |")
    apart = results["fabrics_apart_mm"]
    ratios = [
        results["folds"][f"{kind} {fabrics[1]}"]["curvature"] / results["folds"][f"{kind} {fabrics[0]}"]["curvature"]
        for kind in ("predicted", "simulated")
    ]
    # At least half of the simulated difference, on a logarithmic scale, and in the same direction.
    alike = np.log(ratios[0]) * np.sign(np.log(ratios[1])) >= 0.5 * abs(np.log(ratios[1]))
    verdict = "supported" if (np.diag(matrix) < np.diag(matrix[:, ::-1])).all() else "not supported"
    return [
        *lines,
        "",
        f"The fabrics are {apart['predicted']:.2f} mm apart as predicted and {apart['simulated']:.2f} mm as simulated; "
        f"the two differences correlate by {results['difference_correlation']:.2f}.",
        "",
        f"On average each prediction is nearer to its own fabric's simulation than to the other's: {verdict}.",
        "",
        f"Predicted folds tell the fabrics apart by half as much as simulated ones or more: "
        f"{'supported' if alike else 'not supported'} (curvature of {fabrics[1]} ÷ {fabrics[0]}: "
        f"{ratios[0]:.2f} predicted, {ratios[1]:.2f} simulated).",
    ]
