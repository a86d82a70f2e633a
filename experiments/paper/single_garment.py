"""A model of one garment with one topology (Santesteban et al. 2019, in T-pose), on that garment and on others."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from experiments.shared.errors import Errors
from experiments.shared.evaluate import (
    Pipeline,
    Stack,
    available,
    body_vertices,
    held_out_rows,
    load_all,
    map_pattern,
    open_model,
    ray_ends,
)
from experiments.shared.figures import dressed_cell
from experiments.shared.record import RESULTS, publish
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.metrics import compare_wrinkles, fine_part, vertex_distances
from tryon_jax.nets.mlp import MLP, apply_mlp, init_mlp
from tryon_jax.nets.unet import count_parameters
from tryon_jax.render import SheetItem, contact_sheet
from tryon_jax.training.dataset import default_root
from tryon_jax.training.garments import SimulatedGarment, training_shapes
from tryon_jax.training.loop import LoopOptions, train_loop
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.training_set import dataset_checksum
from tryon_jax.tryon import TryOnModel

COLORS = {"simulated": (0.50, 0.52, 0.55), "single garment": (0.80, 0.50, 0.46), "ours": (0.30, 0.44, 0.62)}
"""Colours of the picture's columns."""
Layers = tuple[Any, ...]
"""Weights and biases of both regressors, as plain tuples for the optimiser."""
_VALIDATION_EVERY = 8


@dataclass(frozen=True)
class Config:
    """What to train and compare; a stopped training continues."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run that it is compared with."""
    cache: Path = Path("runs/single-garment")
    """Folder of the single-garment model's checkpoint."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    garment: str = "tshirt-0"
    """Training garment that the single-garment model is of."""
    fabric: str = "gray-interlock"
    """Fabric."""
    others: tuple[str, ...] = ("tshirt-1", "unseen-tshirt-0", "unseen-longsleeve-0", "unseen-dress-0")
    """Garments that it cannot represent; those that are simulated are measured."""
    loop: LoopOptions = field(
        default_factory=lambda: LoopOptions(steps=4000, learning_rate=2e-3, evaluate_every=250, weight_decay=1e-4)
    )
    batch: int = 32
    """Body shapes in a mini-batch."""
    fit_hidden: int = 20
    """Hidden neurons of the fit regressor, one layer as in the paper of 2019."""
    wrinkle_hidden: int = 200
    """Hidden neurons of the wrinkle regressor. (There it is recurrent in the pose; in T-pose only the betas remain.)"""
    shapes: int = 0
    """Test shapes of each garment, evenly spread; 0 for all."""
    untrained: bool = False
    """Run with stages of ours that are not trained, to try the experiment out."""


@dataclass(frozen=True, eq=False)
class SingleGarment:
    """Garment = its drape on the mean body + fit(β) + wrinkles(β), metres."""

    rest: np.ndarray
    """Simulated drape on the mean body [V, 3]."""
    fit: MLP
    wrinkles: MLP
    scales: tuple[float, float]
    """Sizes of the two displacements, metres."""

    def __call__(self, betas: np.ndarray) -> Stack:
        """Vertices of the one garment on bodies of these shapes."""
        seen = jnp.asarray(betas / 2.0, jnp.float32)
        parts = zip(self.scales, (self.fit, self.wrinkles), strict=True)
        moved = sum(scale * np.asarray(_apply(net, seen)) for scale, net in parts)
        return self.rest[None] + np.asarray(moved).reshape(len(betas), -1, 3)


_apply = jax.jit(apply_mlp)


def train_single(samples: SimulatedGarment, manifest: Manifest, config: Config, dataset: str) -> SingleGarment:
    """Fit both regressors on the garment's training shapes.

    The fit's target is the smoothed change from the drape on the mean body, the wrinkles' is what smoothing removed.

    Raises:
        PermissionError: the garment is for testing.
        ValueError: the drape on the mean body is not good, or fewer than four training shapes are.
    """
    allowed = np.flatnonzero(training_shapes(samples, manifest) & samples.good[config.fabric])
    origin = np.flatnonzero((samples.betas == 0).all(axis=1) & samples.good[config.fabric])
    if not len(origin) or len(allowed) < 4:
        raise ValueError(f"{samples.name} has {len(allowed)} good training shapes in {config.fabric!r}: at least 4")
    held = np.arange(len(allowed)) % _VALIDATION_EVERY == _VALIDATION_EVERY - 1
    if not held.any():
        held[-1] = True
    count = samples.garment.num_vertices
    drapes = samples.drapes[config.fabric]
    moved = drapes[allowed] - drapes[origin]
    fine = fine_part(samples.garment.smoother, moved)
    targets = [x[:, :count].reshape(len(allowed), -1) for x in (moved - fine, fine)]
    first, second = (float(np.sqrt((t[~held] ** 2).mean())) for t in targets)
    scales = first, second
    whole = np.concatenate([t / s for t, s in zip(targets, scales, strict=True)], axis=1)
    inputs = (samples.betas[allowed] / 2.0).astype(np.float32)
    rows, validation = np.flatnonzero(~held), np.flatnonzero(held)

    def predict(nets: Layers, seen: jax.Array) -> jax.Array:
        return jnp.concatenate([apply_mlp(MLP(*net), seen) for net in nets], axis=1)

    def loss(nets: Layers, batch: tuple[jax.Array, jax.Array]) -> jax.Array:
        return ((predict(nets, batch[0]) - batch[1]) ** 2).mean()

    def draw(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        chosen = rng.choice(rows, config.batch)
        return inputs[chosen], whole[chosen]

    def evaluate(nets: Layers) -> float:
        output = np.asarray(predict(nets, jnp.asarray(inputs[validation]))) - whole[validation]
        error = sum(s * part for s, part in zip(scales, np.split(output, 2, axis=1), strict=True))
        return 1e3 * float(np.linalg.norm(np.reshape(error, (len(validation), -1, 3)), axis=-1).mean())

    keys = jax.random.split(jax.random.key(config.loop.seed))
    width = inputs.shape[1]
    sizes = [(width, hidden, 3 * count) for hidden in (config.fit_hidden, config.wrinkle_hidden)]
    nets = [init_mlp(key, layers) for key, layers in zip(keys, sizes, strict=True)]
    start = tuple((net.weights, net.biases) for net in nets)
    identity = {
        "garment": samples.name,
        "fabric": config.fabric,
        "dataset": dataset,
        "options": asdict(config.loop),
        "batch": config.batch,
        "hidden": [config.fit_hidden, config.wrinkle_hidden],
    }
    result = train_loop(start, loss, draw, evaluate, config.cache, config.loop, identity, "single garment")
    fit, wrinkles = (MLP(*net) for net in result.params)
    return SingleGarment(drapes[origin[0], :count], fit, wrinkles, scales)


def carried(single: SingleGarment, betas: np.ndarray, mean: np.ndarray) -> Stack:
    """The best prediction of a fixed topology for another garment: its displacement at the closest place.

    Each vertex of the other garment's mean drape moves as the closest vertex of the one garment does.
    """
    nearest = cKDTree(single.rest).query(mean)[1]
    return mean[None] + (single(betas) - single.rest[None])[:, nearest]


def main(config: Config) -> None:
    """Train the single-garment model, measure it beside ours, and draw both."""
    manifest = load_manifest()
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, (config.fabric,))
    others = available(config.data, config.others)
    garments = load_all(model, config.data, [config.garment, *others])
    own = garments[config.garment]
    single = train_single(own, manifest, config, dataset_checksum(config.data, [config.garment]))
    pipeline = Pipeline(model)
    measured = []
    for name, samples in garments.items():
        rows = held_out_rows(samples, [config.fabric], config.shapes)
        if not len(rows):
            continue
        theirs = predict_for(single, config, samples, rows)
        ours = pipeline(samples, rows, [config.fabric])[config.fabric].fine
        measured.append(
            {"name": name, "how": how(config.garment, name), **compare(samples, rows, theirs, ours, config)}
        )
    results = {
        "garment": config.garment,
        "fabric": config.fabric,
        "training_shapes": int((training_shapes(own, manifest) & own.good[config.fabric]).sum()),
        "bytes": 4 * count_parameters((single.fit, single.wrinkles)),
        "measured": measured,
    }
    publish(config, "single_garment", results, markdown, garments=garments, weights=weights)
    items = picture(model, pipeline, single, garments, config)
    contact_sheet(config.out / "single_garment.jpg", items, columns=3, crop="garment", height=330)
    print(f"wrote {config.out / 'single_garment.jpg'}")


def how(garment: str, name: str) -> str:
    """By which way the single garment's drape reaches another garment."""
    if name == garment:
        return "its own garment"
    same = name.rsplit("-", 1)[0] == garment.rsplit("-", 1)[0]
    return "its own design, carried over in UV" if same else "carried over from the closest place"


def predict_for(single: SingleGarment, config: Config, samples: SimulatedGarment, rows: np.ndarray) -> Stack:
    """The single garment's drapes at the vertices of any garment."""
    betas = samples.betas[rows]
    if samples.name == config.garment:
        return single(betas)
    if samples.label == config.garment.rsplit("-", 1)[0]:
        return map_pattern(config.data, samples.name, config.garment)(single(betas))
    return carried(single, betas, samples.garment.mean_vertices)


def compare(
    samples: SimulatedGarment, rows: np.ndarray, theirs: Stack, ours: Stack, config: Config
) -> dict[str, dict[str, Any]]:
    """Errors of both against the simulation of one garment."""
    count = samples.garment.num_vertices
    simulated = samples.drapes[config.fabric][rows, :count]
    found = {}

    def fine(drapes: Stack) -> Stack:
        padded = np.zeros((len(drapes), samples.garment.graph.num_nodes, 3), np.float32)
        padded[:, :count] = drapes
        return fine_part(samples.garment.smoother, padded)[:, :count]

    for method, drapes in (("single garment", theirs), ("ours", ours)):
        errors = Errors()
        errors.add(vertex_distances(drapes, simulated), ray_ends(samples.betas[rows]))
        if len(rows) > 1:
            errors.wrinkles.append(compare_wrinkles(fine(drapes), fine(simulated)))
        found[method] = errors.summary()
    return found


def picture(
    model: TryOnModel,
    pipeline: Pipeline,
    single: SingleGarment,
    garments: Mapping[str, SimulatedGarment],
    config: Config,
) -> list[SheetItem]:
    """Two shapes of its own garment, then one of each of two designs that it cannot represent."""
    own = garments[config.garment]
    rows = held_out_rows(own, [config.fabric])
    rows = rows[np.argsort(own.betas[rows, -1], kind="stable")]
    cells = [(own, row) for row in (rows[:1].tolist() + rows[-1:].tolist())]
    for name, samples in garments.items():
        if samples.label != own.label and len(found := held_out_rows(samples, [config.fabric])) and len(cells) < 5:
            cells.append((garments[name], int(found[np.linalg.norm(samples.betas[found], axis=1).argmax()])))
    items = []
    for samples, row in cells:
        at = np.array([row])
        body = body_vertices(model, samples.betas[at])[0]
        drapes = {
            "simulated": samples.drapes[config.fabric][row, : samples.garment.num_vertices],
            "single garment": predict_for(single, config, samples, at)[0],
            "ours": pipeline(samples, at, [config.fabric])[config.fabric].fine[0],
        }
        items += [
            dressed_cell(model.body, body, (drape, samples.garment.faces), f"{samples.label}: {title}", COLORS[title])
            for title, drape in drapes.items()
        ]
    return items


def markdown(results: Mapping[str, Any]) -> list[str]:
    """The table with both verdicts: on par on its own garment, and the errors on others."""
    lines = [
        f"Trained on {results['training_shapes']} body shapes of {results['garment']} in {results['fabric']}, from the "
        f"simulated drape on the mean body (which ours does not get); {results['bytes']:,} bytes in float32.",
        "",
        "| garment | how the single garment gets there | single garment: mean · p95 · ends, mm | "
        "ours: mean · p95 · ends, mm | varying wrinkles ÷ simulated (correlation), single · ours |",
        "|---|---|---|---|---|",
    ]
    for entry in results["measured"]:
        cells = [
            " · ".join(_number(entry[m][k]) for k in ("mean_mm", "p95_mm", "ends_mm"))
            for m in ("single garment", "ours")
        ]
        folds = " · ".join(
            f"{_number(entry[m]['wrinkles_varying'])} ({_number(entry[m]['wrinkle_correlation'])})"
            for m in ("single garment", "ours")
        )
        lines.append(f"| {entry['name']} | {entry['how']} | {' | '.join(cells)} | {folds} |")
    verdicts = []
    own = [e for e in results["measured"] if e["name"] == results["garment"]]
    others = [e for e in results["measured"] if e["how"].startswith("carried")]
    if own:
        ratio = own[0]["ours"]["mean_mm"] / own[0]["single garment"]["mean_mm"]
        word = "supported" if ratio <= 1.1 else "not supported"
        verdicts.append(f"On its own garment both are on par (ours at most 10 % worse): {word}, ratio {ratio:.2f}.")
    if others:
        lower = _lower(others)
        word = "supported" if lower == len(others) else "not supported"
        verdicts.append(f"On other designs ours is nearer to the simulation: {word}, on {lower} of {len(others)}.")
    return [*lines, *(line for verdict in verdicts for line in ("", verdict))]


def _lower(entries: Sequence[Mapping[str, Any]]) -> int:
    return sum(e["ours"]["mean_mm"] < e["single garment"]["mean_mm"] for e in entries)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
