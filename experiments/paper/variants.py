"""Short trainings that differ in one thing, for the ablation: what differs, how each is trained, how it is measured."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from experiments.shared.evaluate import Pipeline, fine_parts, held_out_rows, spread
from tryon_jax.garment.manifest import Manifest
from tryon_jax.metrics import compare_wrinkles, vertex_distances
from tryon_jax.nets.config import TryOnConfig, load_config
from tryon_jax.nets.unet import UNetConfig, count_parameters
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.garments import SimulatedGarment, load_cloth
from tryon_jax.training.stage_fit import fit_stage
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_prediction import Predictor
from tryon_jax.training.stage_sets import StageSet, fine_sets, smooth_sets
from tryon_jax.tryon import TryOnModel, init_model

BLOCK = ((-1.6, -0.1), (0.4, 1.5))
"""Lowest and highest of each beta: a hole inside the range, wider than the gap between two shapes of a ray."""
_ALONG = 0.1
"""Size of the other betas beside the first up to which a shape counts as along it (no ray of the 25 points straight
the other way)."""


@dataclass(frozen=True)
class Variant:
    """What differs from the configuration `small`."""

    title: str
    config: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the model's configuration."""
    order: int = 0
    """Chebyshev order K of both networks; 0 leaves it."""
    skinning_weights: bool = True
    """False: nodes do not know the skinning weights of the closest body vertex."""
    one_stage: bool = False
    """One network learns the simulation itself, for as many steps as both have."""
    designs: float = 1.0
    """Share of the training designs, evenly spread."""
    additional: bool = False
    """Train on the manifest's additional designs as well."""
    shapes: str = "all"
    """ "all", "first beta": along the first beta alone, or "block": all but `BLOCK`."""
    bodies: int = 0
    """Body shapes of each garment in a batch; 0 leaves them."""
    loss: Mapping[str, float] = field(default_factory=dict)
    """Weights of further terms in R_fine's loss, fields of `StageOptions`."""


_FLAT = UNetConfig(widths=(48,), encoder_convs=11)

VARIANTS: dict[str, Variant] = {
    "base": Variant("`small` as it is"),
    "node": Variant(
        "the paper's form, `small-node`",
        {
            name: getattr(load_config("small-node"), name)
            for name in ("conditioning", "wavelengths", "design_features", "laplacian", "smooth", "fine")
        },
        bodies=4,
    ),
    "no-waves": Variant("no sines and cosines of the position", {"wavelengths": ()}),
    "no-design": Variant("nodes do not know the design", {"design_features": False}),
    "pattern": Variant("nodes know their place on the pattern, and its waves", {"pattern_features": True}),
    "symmetric": Variant("symmetric Laplacian", {"laplacian": "symmetric"}),
    "fields-8": Variant("K = 8 fields", {"fields": 8}),
    "fields-48": Variant("K = 48 fields", {"fields": 48}),
    "edges": Variant("R_fine's loss has the error of edges too", loss={"edges": 2.0}),
    "normals": Variant("R_fine's loss has the error of normals too", loss={"normals": 10.0}),
    "energy": Variant("R_fine's loss has the cloth's energy too", loss={"energy": 0.01}),
    "no-weights": Variant("no skinning weights in the node", skinning_weights=False),
    "one-stage": Variant("one network in place of R_smooth and R_fine", {"reference": "paper"}, one_stage=True),
    "no-pooling": Variant(
        "no pooling: as many convolutions at full resolution",
        {"smooth": _FLAT, "fine": replace(_FLAT, encoder_convs=8)},
    ),
    "order-1": Variant("K = 1: no neighbours but by pooling", order=1),
    "order-3": Variant("K = 3", order=3),
    "order-4": Variant("K = 4", order=4),
    "paper-reference": Variant("displacement from M̄, as in the paper", {"reference": "paper"}),
    "one-beta": Variant("trained along the first beta alone", shapes="first beta"),
    "held-out-block": Variant("a block of betas held out", shapes="block"),
    "half-designs": Variant("half of the designs", designs=0.5),
    "quarter-designs": Variant("a quarter of the designs", designs=0.25),
    "more-designs": Variant("the additional designs as well", additional=True),
}
"""Each differs from "base" in one thing."""


def in_block(betas: Float[np.ndarray, "S b"]) -> Bool[np.ndarray, " S"]:
    """Which body shapes lie in the block that one variant never sees."""
    low, high = np.array(BLOCK).T
    return ((betas >= low[None]) & (betas <= high[None])).all(axis=1)


def along_first(betas: Float[np.ndarray, "S b"]) -> Bool[np.ndarray, " S"]:
    """Which body shapes differ from the mean in little but the first beta; the mean body is among them."""
    return np.asarray((np.abs(betas[:, 1:]) <= _ALONG * np.abs(betas[:, :1])).all(axis=1))


def variant_config(variant: Variant, config: TryOnConfig) -> TryOnConfig:
    """The configuration of a variant's networks, which start from M_smooth."""
    changed = replace(config, kriging=None, **variant.config)
    if variant.order:
        changed = replace(
            changed,
            smooth=replace(changed.smooth, order=variant.order),
            fine=replace(changed.fine, order=variant.order),
        )
    return changed


def variant_garments(variant: Variant, names: Sequence[str], manifest: Manifest) -> list[str]:
    """Those of the available training garments that a variant sees; validation designs only choose weights."""
    paper = [design.label for design in manifest.training]
    kept = [paper[k] for k in spread(len(paper), round(variant.designs * len(paper)))]
    extra = {design.label for design in manifest.additional} - set(manifest.validation) if variant.additional else set()
    wanted = {*kept, *extra, *manifest.validation}
    return [name for name in names if name.rsplit("-", 1)[0] in wanted]


def without_weights(samples: SimulatedGarment) -> SimulatedGarment:
    """The same garment whose nodes do not know where on the body they are (zero inputs have no weights to learn)."""
    graph = samples.garment.graph
    blind = replace(graph, skinning_weights=np.zeros_like(graph.skinning_weights))
    return replace(samples, garment=replace(samples.garment, graph=blind))


def restrict(kept: Bool[np.ndarray, " S"], stage_set: StageSet) -> StageSet:
    """A stage's samples less those that are not kept; validation is chosen anew where too few are left of it."""
    if kept.all():
        return stage_set
    train, validation = stage_set.train & kept, stage_set.validation & kept
    if train.any() and not validation.any():
        allowed = np.flatnonzero(train)
        validation[allowed[len(allowed) // 2]] = True
        train = train & ~validation
    return replace(stage_set, train=train, validation=validation)


def train_variant(
    variant: Variant,
    start: TryOnModel,
    samples: Sequence[SimulatedGarment],
    manifest: Manifest,
    fabric: str,
    root: Path,
    folder: Path,
    options: StageOptions,
    fine_steps: int,
    checksum: str,
) -> tuple[TryOnModel, dict[str, Any]]:
    """R_smooth and one R_fine of a variant, with R_mean of `start`; stopped trainings continue.

    Args:
        variant: what differs.
        start: gives R_mean, the body and the configuration that is varied.
        samples: the garments that the variant sees, without test garments.
        manifest: the splits.
        fabric: whose R_fine is trained.
        root: of the dataset, which has the rest states of garments.
        folder: keeps checkpoints.
        options: of R_smooth's training, and of R_fine's but for the steps.
        fine_steps: of R_fine's.
        checksum: of the data.
    """
    config = variant_config(variant, start.config)
    model = replace(init_model(jax.random.key(0), config, body=start.body), mean=start.mean)
    if not variant.skinning_weights:
        samples = [without_weights(s) for s in samples]

    def kept(s: SimulatedGarment) -> Bool[np.ndarray, " S"]:
        if variant.shapes == "block":
            return ~in_block(s.betas)
        return along_first(s.betas) if variant.shapes == "first beta" else np.ones(len(s.betas), bool)

    def steps(count: int) -> StageOptions:
        loop = replace(options.loop, steps=count, evaluate_every=min(options.loop.evaluate_every, count))
        return replace(options, loop=loop, shapes=variant.bodies or options.shapes)

    sets = [restrict(kept(s), x) for s, x in zip(samples, smooth_sets(samples, manifest), strict=True)]
    total = options.loop.steps
    if variant.one_stage:
        total += fine_steps
        sets = [
            replace(
                x, targets=s.drapes[fabric], train=x.train & s.good[fabric], validation=x.validation & s.good[fabric]
            )
            for s, x in zip(samples, sets, strict=True)
        ]
    stage, smooth = fit_stage(model, "smooth", model.smooth, sets, folder / "smooth", steps(total), checksum)
    model = replace(model, smooth=stage)
    record = {
        "parameters": count_parameters(stage.net),
        "garments": sum(bool(x.train.any()) for x in sets),
        "samples": int(sum(x.train.sum() for x in sets)),
        "smooth": {key: smooth[key] for key in ("steps", "seconds", "curve")},
    }
    if variant.one_stage:
        return model, record
    predictor = Predictor(config, "smooth")
    before = [predictor(stage, s.garment, s.betas) for s in samples]
    fine_options = replace(steps(fine_steps), **variant.loss)
    cloths = [load_cloth(root, s) for s in samples] if fine_options.energy else None
    sets = fine_sets(samples, manifest, fabric, before, cloths)
    fine = [restrict(kept(s), x) for s, x in zip(samples, sets, strict=True)]
    stage, last = fit_stage(
        model,
        "fine",
        model.fine[fabric],
        fine,
        folder / f"fine-{fabric}",
        fine_options,
        checksum,
        load_fabric(fabric),
    )
    model = replace(model, fine={fabric: stage})
    record["parameters"] += count_parameters(stage.net)
    record["fine"] = {key: last[key] for key in ("steps", "seconds", "curve")}
    return model, record


def measure_variant(
    variant: Variant, model: TryOnModel, cases: Mapping[str, Sequence[SimulatedGarment]], fabric: str, shapes: int
) -> dict[str, list[dict[str, Any]]]:
    """Error of each test sample of each garment in each case, millimetres: M_smooth and M_fine; and of its folds.

    All shapes of the block and along the first beta are measured, and `shapes` others.
    """
    pipeline = Pipeline(model)
    found: dict[str, list[dict[str, Any]]] = {}
    for case, group in cases.items():
        found[case] = []
        for garment in group:
            rows = held_out_rows(garment, [fabric])
            special = in_block(garment.betas[rows]) | along_first(garment.betas[rows])
            rows = np.union1d(rows[special], rows[spread(len(rows), shapes)])
            if not len(rows):
                continue
            samples = garment if variant.skinning_weights else without_weights(garment)
            predicted = pipeline(samples, rows, [fabric])[fabric]
            fine = predicted.smooth if variant.one_stage else predicted.fine
            simulated = samples.drapes[fabric][rows, : samples.garment.num_vertices]
            folds = compare_wrinkles(*(fine_parts(samples, x) for x in (fine, simulated))) if len(rows) > 1 else None
            found[case].append(
                {
                    "name": garment.name,
                    "folds": None if folds is None else [folds.varying, folds.correlation],
                    "betas": samples.betas[rows].tolist(),
                    "smooth_mm": (1e3 * vertex_distances(predicted.smooth, simulated).mean(axis=1)).tolist(),
                    "fine_mm": (1e3 * vertex_distances(fine, simulated).mean(axis=1)).tolist(),
                }
            )
    return found


def options_record(options: StageOptions, fine_steps: int) -> dict[str, Any]:
    """What all variants share."""
    return {**asdict(options), "fine_steps": fine_steps}
