"""Accuracy: millimetres from the simulation, for the pipeline and for simpler methods."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from tqdm import tqdm

from experiments.paper.accuracy_table import TWINS, draw, markdown
from experiments.shared.errors import Errors
from experiments.shared.evaluate import (
    Pipeline,
    Prediction,
    Stack,
    available,
    case_names,
    fine_parts,
    held_out_rows,
    load_all,
    map_pattern,
    open_model,
    ray_ends,
    rows_with,
    spread,
)
from experiments.shared.neighbours import Drapes, NearestGarments, load_drapes, transfer
from experiments.shared.record import RESULTS, publish
from experiments.shared.refined import Refiner
from tryon_jax.checks import check_range
from tryon_jax.contact.skin import Skin
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.metrics import compare_wrinkles, vertex_distances
from tryon_jax.nets.kriging import Kriging, KrigingConfig
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.kriging import KrigingFit
from tryon_jax.training.node_drapes import read_nodes
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import TryOnModel, load_model
from tryon_jax.tryon.shared_fine import add_shared_fine

Table = dict[str, dict[str, Errors]]
"""Errors by row and fabric."""


@dataclass(frozen=True)
class Config:
    """What to compare, and how much of it."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run."""
    paper_form: Path | None = None
    """Folder of a run in the paper's form (`train --size small-node`), measured beside it."""
    shared: Path | None = None
    """File of an R_fine of all fabrics that goes with the run (small-fabrics of the package goes with what is shipped):
    adds the row of a mesh without a design."""
    dressed: Path | None = None
    """Folder of a dataset whose garments were dressed by themselves (`simulate --convention dressed`): how far the
    pipeline, and the convention that it learns, are from those."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    shapes: int = 0
    """Test shapes of each garment, evenly spread; 0 for all."""
    garments: int = 0
    """Garments of each case, evenly spread; 0 for all. The kNN always has all training garments."""
    inside_shapes: int = 2
    """Shapes of each garment whose vertices inside the body are counted."""
    refine: int = 5
    """Steps of the solver after the drapes of unseen designs and topologies, in a row of their own; 0 leaves it out."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Measure every row of every case and print, draw and store the table."""
    check_range("refine", config.refine, 0, 10_000, "steps")
    manifest = load_manifest()
    fabrics = read_config(config.data).fabrics
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, fabrics)
    if config.shared is not None:
        model = add_shared_fine(model, config.shared)
    full, cases = case_names(config.data, manifest), case_names(config.data, manifest, config.garments)
    # Unseen topologies are of one design: they are compared with its trained topologies on the same shapes.
    twins = {name.rsplit("-", 1)[0] for name in full["unseen topology"]}
    cases[TWINS] = [n for n in full["as trained"] if n.rsplit("-", 1)[0] in twins]
    wanted_names = sorted({name for names in cases.values() for name in names})
    garments = load_all(model, config.data, wanted_names)
    rival = None if config.paper_form is None else Rival.load(config.paper_form, config.data, wanted_names)
    wanted = {
        (case, n): held_out_rows(garments[n], fabrics, config.shapes) for case, names in cases.items() for n in names
    }
    shared = [garments[n].betas[wanted["unseen topology", n]] for n in cases["unseen topology"]]
    for name in cases[TWINS]:
        every = held_out_rows(garments[name], fabrics, 0)
        wanted[TWINS, name] = rows_with(garments[name], every, np.concatenate(shared))
    betas = np.unique(np.concatenate([garments[n].betas[rows] for (_, n), rows in wanted.items()]), axis=0)
    # All that any training may see, so that the kNN has all that the networks were given.
    known = available(config.data, manifest.training_garments())
    trained = {f: {n: load_drapes(model, config.data, n, f) for n in known} for f in fabrics}
    neighbours = {f: NearestGarments(list(trained[f].values()), manifest, betas) for f in fabrics}
    pipeline, kriging = Pipeline(model), krige(model, config.data, known, fabrics)
    refiner = Refiner(model.body, config.data, config.refine) if config.refine else None
    tables: dict[str, Table] = {case: {} for case in cases}
    for case, names in cases.items():
        for name in tqdm(names, desc=case, mininterval=2):
            rows = wanted[case, name]
            if not len(rows):
                continue
            predicted = pipeline(garments[name], rows, fabrics)
            measured = measure(
                garments[name], rows, predicted, pipeline, kriging, neighbours, config.inside_shapes, rival
            )
            if refiner is not None and case.startswith("unseen"):
                measure_refined(measured, garments[name], rows, predicted, refiner)
            measure_spread(measured, config.data, garments[name], rows, trained)
            if config.dressed is not None and available(config.dressed, [name]):
                measure_dressed(measured, config.dressed, garments[name], rows, predicted, model)
            for row, by_fabric in measured.items():
                for fabric, errors in by_fabric.items():
                    tables[case].setdefault(row, {}).setdefault(fabric, Errors()).update(errors)
    results = {
        "garments": {case: len(names) for case, names in cases.items()},
        "known_garments": len(known),
        "table": {
            case: {row: {fabric: e.summary() for fabric, e in by.items()} for row, by in table.items()}
            for case, table in tables.items()
        },
    }
    publish(config, "accuracy", results, markdown, draw, garments={*garments, *known}, weights=weights)


@dataclass(frozen=True, eq=False)
class Rival:
    """Another model, with the garments prepared for it."""

    pipeline: Pipeline
    garments: Mapping[str, SimulatedGarment]

    @classmethod
    def load(cls, run: Path, root: Path, names: Sequence[str]) -> "Rival":
        """The model of a run, and garments of a dataset."""
        model = load_model(model_path(run))
        return cls(Pipeline(model), load_all(model, root, names))

    def __call__(self, samples: SimulatedGarment, rows: np.ndarray, fabrics: Sequence[str]) -> dict[str, Stack]:
        """Its drapes of the samples with the given rows, by fabric."""
        found = self.pipeline(self.garments[samples.name], rows, fabrics)
        return {fabric: prediction.fine for fabric, prediction in found.items()}


def krige(model: TryOnModel, root: Path, known: Sequence[str], fabrics: Sequence[str]) -> Mapping[str, Kriging]:
    """The model's kriged drapes; where it has none, those of the garments that it may have been trained on."""
    if model.kriging or not known:
        return model.kriging
    manifest, samples = load_manifest(), list(load_all(model, root, known).values())
    config = KrigingConfig()
    return {fabric: KrigingFit(read_nodes(model, samples, manifest, fabric), config).kriging for fabric in fabrics}


def measure(
    samples: SimulatedGarment,
    rows: np.ndarray,
    predicted: Mapping[str, Prediction],
    pipeline: Pipeline,
    kriging: Mapping[str, Kriging],
    neighbours: Mapping[str, NearestGarments],
    inside_shapes: int,
    rival: Rival | None = None,
) -> Table:
    """Errors of every row of the table on one garment."""
    table: Table = {}
    count, ends = samples.garment.num_vertices, ray_ends(samples.betas[rows])
    looked_at = spread(len(rows), inside_shapes)
    skins = [Skin.of_shape(pipeline.model.body, samples.betas[rows[k]]) for k in looked_at]
    rivals = {} if rival is None else rival(samples, rows, list(neighbours))
    for fabric, drapes in _predictions(samples, rows, predicted, pipeline, kriging, neighbours).items():
        if fabric in rivals:
            drapes["paper form"] = rivals[fabric]
        simulated = samples.drapes[fabric][rows, :count]
        fine = fine_parts(samples, simulated)
        for row, shown in {**drapes, "simulation": simulated}.items():
            errors = table.setdefault(row, {}).setdefault(fabric, Errors())
            errors.add(vertex_distances(shown, simulated), ends)
            errors.inside += [skin.inside_share(shown[k]) for skin, k in zip(skins, looked_at, strict=True)]
            if len(rows) > 1:
                errors.wrinkles.append(compare_wrinkles(fine_parts(samples, shown), fine))
        own = table.setdefault("smooth, own target", {}).setdefault(fabric, Errors())
        own.add(vertex_distances(drapes["smooth"], samples.target[rows, :count]), ends)
    return table


def _predictions(
    samples: SimulatedGarment,
    rows: np.ndarray,
    predicted: Mapping[str, Prediction],
    pipeline: Pipeline,
    kriging: Mapping[str, Kriging],
    neighbours: Mapping[str, NearestGarments],
) -> dict[str, dict[str, Stack]]:
    mean, count = samples.garment.mean_vertices, samples.garment.num_vertices
    still = np.broadcast_to(mean[None], (len(rows), count, 3))
    moved = transfer(pipeline.model, mean, samples.betas[rows])
    detail = fine_parts(samples, mean[None])
    origin = np.flatnonzero((samples.betas == 0).all(axis=1))
    found = {}
    for fabric, stages in predicted.items():
        drapes = {
            "mean drape": still,
            "transfer": moved,
            "neighbours": neighbours[fabric](samples, rows, with_design=False),
            "neighbours, design": neighbours[fabric](samples, rows, with_design=True),
            "smooth": stages.smooth,
            "mean detail": stages.smooth + detail,
            "pipeline": stages.fine,
        }
        if fabric in kriging:
            drapes["kriging"] = pipeline.kriged(kriging[fabric], samples, rows)
        bare = pipeline.without_design(samples, rows, fabric)
        drapes |= {} if bare is None else {"bare": bare}
        if len(origin) and samples.good[fabric][origin].all():
            drapes["carried offset"] = stages.smooth + fine_parts(samples, samples.drapes[fabric][origin, :count])
        found[fabric] = drapes
    return found


def measure_refined(
    table: Table,
    samples: SimulatedGarment,
    rows: np.ndarray,
    predicted: Mapping[str, Prediction],
    refiner: Refiner,
) -> None:
    """Errors of the pipeline's drapes after a few steps of the solver."""
    betas, count = samples.betas[rows], samples.garment.num_vertices
    for fabric, stages in predicted.items():
        simulated = samples.drapes[fabric][rows, :count]
        refined = refiner(samples.name, fabric, betas, stages.fine)
        errors = table.setdefault("refined", {}).setdefault(fabric, Errors())
        errors.add(vertex_distances(refined, simulated), ray_ends(betas))
        if len(rows) > 1:
            errors.wrinkles.append(compare_wrinkles(fine_parts(samples, refined), fine_parts(samples, simulated)))


def measure_spread(
    table: Table, root: Path, here: SimulatedGarment, rows: np.ndarray, trained: Mapping[str, Mapping[str, Drapes]]
) -> None:
    """Distance of the simulation on another, trained mesh of the same design, at this one's vertices."""
    mean, count = here.garment.mean_vertices, here.garment.num_vertices
    for fabric, by_name in trained.items():
        other = next((n for n in by_name if n.rsplit("-", 1)[0] == here.label and n != here.name), None)
        if other is None:
            return
        there, onto = by_name[other], map_pattern(root, here.name, other)
        pairs = [(k, np.flatnonzero((there.betas == here.betas[k]).all(axis=1) & there.good)) for k in rows]
        same = [(k, j[0]) for k, j in pairs if len(j)]
        if not same:
            continue
        first, second = (np.array(column) for column in zip(*same, strict=True))
        drapes = onto(there.vertices[second])
        moved = mean[None] + onto(there.vertices[second] - there.mean[None])
        for row, found in (("spread", moved), ("spread, drape", drapes)):
            errors = table.setdefault(row, {}).setdefault(fabric, Errors())
            errors.add(vertex_distances(found, here.drapes[fabric][first, :count]), ray_ends(here.betas[first]))


def measure_dressed(
    table: Table,
    root: Path,
    here: SimulatedGarment,
    rows: np.ndarray,
    predicted: Mapping[str, Prediction],
    model: TryOnModel,
) -> None:
    """Distances from the drapes of the same mesh that were dressed by themselves."""
    count = here.garment.num_vertices
    for fabric in predicted:
        there = load_drapes(model, root, here.name, fabric)
        pairs = [
            (k, np.flatnonzero((there.betas == here.betas[row]).all(axis=1) & there.good)) for k, row in enumerate(rows)
        ]
        same = [(k, found[0]) for k, found in pairs if len(found)]
        if not same:
            continue
        mine, theirs = (np.array(column) for column in zip(*same, strict=True))
        ends = ray_ends(here.betas[rows[mine]])
        drapes = {
            "dressed": predicted[fabric].fine[mine],
            "dressed, simulation": here.drapes[fabric][rows[mine], :count],
        }
        for row, drape in drapes.items():
            errors = table.setdefault(row, {}).setdefault(fabric, Errors())
            errors.add(vertex_distances(drape, there.vertices[theirs]), ends)
