"""Does the report of the fit warn of the garments that the simulation found too tight to be put on?"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr
from tqdm import tqdm

from experiments.shared.evaluate import Pipeline, body_vertices, case_names, load_all, open_model, spread
from experiments.shared.record import RESULTS, publish
from measuring.records import table
from tryon_jax.body.landmarks import load_landmarks
from tryon_jax.checks import check_range
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.physics.stretch import MAX_TENSION
from tryon_jax.training.dataset import default_root, load_arrays, mesh_path, read_config
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.samples import read_samples
from tryon_jax.wear.fit import measure_fit


@dataclass(frozen=True)
class Config:
    """What to look at."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run."""
    out: Path = RESULTS
    """Folder for the record."""
    garments: int = 12
    """Garments of each case, evenly spread; 0 for all."""
    shapes: int = 8
    """Test shapes of each garment, evenly spread, the excluded ones among them; 0 for all."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Compare the largest tension of each learned drape with that of the simulation, kept or not."""
    check_range("garments", config.garments, 0, 10_000)
    check_range("shapes", config.shapes, 0, 10_000)
    fabrics = read_config(config.data).fabrics
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, fabrics)
    cases = case_names(config.data, load_manifest(), config.garments)
    garments = load_all(model, config.data, sorted({name for names in cases.values() for name in names}))
    simulated = {
        (sample.garment, sample.fabric, _key(sample.betas)): sample.statistics["tension"]
        for sample in read_samples(config.data)
        if sample.test and np.isfinite(sample.statistics["tension"])
    }
    pipeline, landmarks = Pipeline(model), load_landmarks(model.body)
    faces = np.asarray(model.body.faces)
    pairs: dict[str, list[tuple[float, float]]] = {fabric: [] for fabric in fabrics}
    for name, samples in tqdm(garments.items(), desc="garments", mininterval=2):
        mesh = load_arrays(mesh_path(config.data, name))
        rows = np.flatnonzero(samples.test)
        rows = rows[spread(len(rows), config.shapes)]
        bodies = body_vertices(model, samples.betas[rows])
        for fabric, predicted in pipeline(samples, rows, fabrics).items():
            cloth = load_fabric(fabric)
            for k, row in enumerate(rows):
                tension = simulated.get((name, fabric, _key(samples.betas[row])))
                if tension is None:
                    continue
                surface = ClosedSurface(bodies[k], faces)
                fit = measure_fit(
                    surface, landmarks, predicted.fine[k], mesh["faces"], mesh["uv"], mesh["faces_uv"], cloth
                )
                pairs[fabric].append((max(fit.pull.values(), default=0.0), tension))
    results = {"limit": MAX_TENSION, "garments": len(garments), "fabrics": [compare(f, pairs[f]) for f in fabrics]}
    publish(config, "tightness", results, markdown, garments=garments, weights=weights)


def _key(betas: Iterable[float]) -> tuple[float, ...]:
    # Stored in different precisions; shapes of the protocol lie far more than this apart.
    return tuple(round(float(beta), 4) for beta in betas)


def compare(fabric: str, pairs: list[tuple[float, float]]) -> dict[str, Any]:
    """Correlation of the tensions of learned and of simulated drapes, N/m, for one fabric."""
    pull, tension = np.array(pairs).reshape(-1, 2).T
    warned, tight = pull > MAX_TENSION, tension > MAX_TENSION
    varies = len(pairs) > 2 and pull.std() > 0 and tension.std() > 0
    return {
        "fabric": fabric,
        "drapes": len(pairs),
        "rank correlation": float(spearmanr(pull, tension).statistic) if varies else None,
        "too tight in the simulation": int(tight.sum()),
        "of these warned of": int((warned & tight).sum()),
        "warned of others": int((warned & ~tight).sum()),
    }


def markdown(results: dict[str, Any]) -> list[str]:
    """Section of docs/RESULTS.md."""
    return [
        f"Largest pull round chest, waist and hip of a learned drape, as `tryon drape` reports it, beside the tension "
        f"(95th percentile over the cloth) of the simulation of the same garment and body, on test shapes of "
        f"{results['garments']} garments. Both count as too tight above {results['limit']:g} N/m; networks never see "
        "such drapes.",
        "",
        table(results["fabrics"]),
    ]
