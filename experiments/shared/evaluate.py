"""Shared by the experiments that compare with simulations: loading, predicting, mapping between topologies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from tqdm import tqdm

from experiments.shared.record import simulated_fabrics, stages_trained
from tryon_jax.garment.manifest import Manifest
from tryon_jax.garment.pattern_map import PatternMap, map_patterns
from tryon_jax.metrics import fine_part
from tryon_jax.nets.kriging import Kriging
from tryon_jax.training.dataset import load_arrays, mesh_path, read_config
from tryon_jax.training.garments import SimulatedGarment, load_simulated
from tryon_jax.training.protocol import EXTENT
from tryon_jax.training.stage_prediction import CHUNK, Predictor
from tryon_jax.tryon import (
    Garment,
    Stage,
    TryOnModel,
    base_and_detail,
    correct,
    fine_base,
    fine_of,
    load_model,
    measure_corrections,
    stages_of,
)

Stack = Float[np.ndarray, "S V 3"]


@dataclass(frozen=True, eq=False)
class Prediction:
    """M_smooth and M_fine of some shapes of a garment, unpadded, metres."""

    smooth: Stack
    fine: Stack


class Pipeline:
    """A model's two stages for many shapes of many garments; compiled once for each size."""

    def __init__(self, model: TryOnModel) -> None:
        self.model = model
        self._smooth, self._fine = Predictor(model.config, "smooth"), Predictor(model.config, "fine")
        self._base_and_detail = jax.jit(base_and_detail, static_argnums=0)
        self._measure, self._correct = jax.jit(measure_corrections), jax.jit(correct)

    def __call__(self, samples: SimulatedGarment, rows: np.ndarray, fabrics: Sequence[str]) -> dict[str, Prediction]:
        """Predictions of the samples with the given rows, by fabric."""
        garment, betas = samples.garment, samples.betas[rows]
        smooth = self._smooth(self.model.smooth, garment, betas)
        count = garment.num_vertices
        found = {}
        for fabric in fabrics:
            first, stage = stages_of(self.model, garment, fabric)
            start = smooth if first is self.model.smooth else self._smooth(first, garment, betas)
            found[fabric] = Prediction(smooth[:, :count], self._drape(first, stage, garment, betas, start)[:, :count])
        return found

    def kriged(self, kriging: Kriging, samples: SimulatedGarment, rows: np.ndarray) -> Stack:
        """Kriged drapes, which the model need not have."""
        garment, config = samples.garment, self.model.config
        detail = np.asarray(fine_base(config, self._base_and_detail(config, garment)[1]))
        return (self._smooth(kriging, garment, samples.betas[rows]) + detail[None])[:, : garment.num_vertices]

    def without_design(self, samples: SimulatedGarment, rows: np.ndarray, fabric: str) -> Stack | None:
        """M_fine as for a mesh without a design; None where the model cannot drape such in this fabric."""
        if fabric not in self.model.config.shared_fabrics:
            return None
        garment = replace(samples.garment, design=None, template_vertices=None, template_weights=None)
        betas = samples.betas[rows]
        first, stage = self.model.smooth, fine_of(self.model, fabric)
        start = self._smooth(first, garment, betas)
        return self._drape(first, stage, garment, betas, start)[:, : garment.num_vertices]

    def _drape(
        self, first: Stage | Kriging, stage: Stage, garment: Garment, betas: Float[np.ndarray, "S b"], start: np.ndarray
    ) -> Float[np.ndarray, "S N 3"]:
        """M_fine from what it starts from, corrected as `drape` corrects it."""
        fine, skin = self._fine(stage, garment, betas, start), self.model.skin
        if skin is None:
            return fine
        shapes = np.asarray(skin.polynomials.betas)
        on_skins = self._fine(stage, garment, shapes, self._smooth(first, garment, shapes))
        return np.asarray(self._correct(self._measure(skin, garment, on_skins, on_skins), fine, betas))


def fine_parts(samples: SimulatedGarment, drapes: Stack) -> Stack:
    """What smoothing takes from some drapes of a garment, unpadded, metres."""
    count = samples.garment.num_vertices
    # Padded in shapes as well, so that few sizes are compiled.
    size = -(-len(drapes) // CHUNK) * CHUNK
    padded = np.zeros((size, samples.garment.graph.num_nodes, 3), np.float32)
    padded[: len(drapes), :count] = drapes
    return fine_part(samples.garment.smoother, padded)[: len(drapes), :count]


def open_model(path: Path, untrained: bool, fabrics: tuple[str, ...]) -> TryOnModel:
    """A trained model.

    Raises:
        ValueError: a stage is not trained yet; `untrained` lets it pass, to try an experiment out.
    """
    missing = stages_trained(path, fabrics)
    if missing and not untrained:
        raise ValueError(f"{str(path)!r} has not been trained yet: {', '.join(missing)}")
    return load_model(path)


def available(root: Path, names: Sequence[str]) -> list[str]:
    """Those of the garments that are simulated in every fabric of the dataset and along one ray at least."""
    fabrics = set(read_config(root).fabrics)
    return [
        name
        for name in names
        if set(simulated_fabrics(root, name)) == fabrics
        and all(any((root / "rays").glob(f"{name}_{fabric}_*.npz")) for fabric in fabrics)
    ]


def case_names(root: Path, manifest: Manifest, per_case: int = 0) -> dict[str, list[str]]:
    """Garments of the three cases that the dataset holds: as trained, unseen topologies, unseen designs.

    With `per_case`, so many of each, spread evenly.
    """
    training = [f"{d.label}-{s}" for d in manifest.training for s in manifest.training_seeds]
    topologies = [f"{d.label}-{s}" for d in manifest.training for s in manifest.test_seeds]
    unseen = [f"{d.label}-{s}" for d in manifest.unseen for s in manifest.training_seeds + manifest.test_seeds]
    cases = {"as trained": training, "unseen topology": topologies, "unseen design": unseen}
    found = {case: available(root, names) for case, names in cases.items()}
    if per_case:
        found = {case: [n[i] for i in spread(len(n), per_case)] for case, n in found.items()}
    return found


def spread(count: int, most: int) -> Int[np.ndarray, " K"]:
    """At most `most` indices below `count`, evenly spaced; all of them when `most` is 0."""
    if not most or count <= most:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, most).round().astype(int))


def load_all(model: TryOnModel, root: Path, names: Sequence[str]) -> dict[str, SimulatedGarment]:
    """Garments with their drapes, prepared for the model."""
    fabrics = read_config(root).fabrics
    return {name: load_simulated(model, root, name, fabrics) for name in tqdm(names, desc="garments", mininterval=2)}


def held_out_rows(samples: SimulatedGarment, fabrics: Sequence[str], most: int = 0) -> Int[np.ndarray, " K"]:
    """Rows of test shapes whose simulations are good in every given fabric."""
    good = np.all([samples.good[f] for f in fabrics], axis=0) & samples.test
    rows = np.flatnonzero(good)
    return rows[spread(len(rows), most)]


def map_pattern(root: Path, name: str, other: str) -> PatternMap:
    """Locate each vertex of garment `name` in the pattern of `other`."""
    return map_patterns(load_arrays(mesh_path(root, name)), load_arrays(mesh_path(root, other)))


def rows_with(samples: SimulatedGarment, rows: np.ndarray, betas: Float[np.ndarray, "K b"]) -> Int[np.ndarray, " J"]:
    """Those of the rows whose body shape is among `betas`."""
    known = {tuple(map(float, beta)) for beta in betas}
    return rows[[tuple(map(float, beta)) in known for beta in samples.betas[rows]]]


def common_rows(garments: Mapping[str, SimulatedGarment], fabrics: Sequence[str], most: int) -> dict[str, np.ndarray]:
    """Rows of the test shapes that are good for every one of the garments: what may be compared between them."""
    rows = {name: held_out_rows(samples, fabrics, 0) for name, samples in garments.items()}
    for first, samples in garments.items():
        rows = {name: rows_with(garments[name], rows[name], samples.betas[rows[first]]) for name in garments}
    # All have the same shapes in the same (sorted) order now.
    return {name: found[spread(len(found), most)] for name, found in rows.items()}


def ray_ends(betas: Float[np.ndarray, "S b"]) -> Bool[np.ndarray, " S"]:
    """Which body shapes lie at the end of a ray: the border of what the dataset covers."""
    return np.linalg.norm(betas / np.array(EXTENT[: betas.shape[1]])[None], axis=1) >= 0.99


def body_vertices(model: TryOnModel, betas: Float[np.ndarray, "S b"]) -> Float[np.ndarray, "S W 3"]:
    """Vertices of the body of each shape."""
    body = model.body
    directions = np.asarray(body.shapedirs)[..., : betas.shape[1]]
    return np.asarray(body.v_template)[None] + np.einsum("vdb,sb->svd", directions, betas)
