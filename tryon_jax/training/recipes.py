"""The steps from a simulated dataset to a trained model; each continues from what its folder holds.

RUN/model.safetensors     the model so far: R_mean, then R_smooth, then one R_fine after the other
RUN/mean/, RUN/smooth/, RUN/fine-<fabric>/      curve.csv, checkpoint.npz, record.json of each stage

A stage starts from the weights in the model: where RUN holds nothing but a trained model, it is trained further, and
the record of its earlier training stays inside the new one.
"""

import hashlib
import json
import platform
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from tryon_jax.files.atomic import write_text
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.nets import store
from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.unet import count_parameters
from tryon_jax.physics.fabrics import Fabric, load_fabric
from tryon_jax.training.carried import fresh_topologies
from tryon_jax.training.collisions import with_fine
from tryon_jax.training.dataset import read_config
from tryon_jax.training.drapes import has_drapes
from tryon_jax.training.garments import SimulatedGarment, load_cloth, load_simulated
from tryon_jax.training.kriging import KrigingFit, kriged_starts
from tryon_jax.training.loop import LoopOptions, TimeLimits, train_loop
from tryon_jax.training.mean import MeanTraining, load_templates, mean_error, train_mean
from tryon_jax.training.node_drapes import read_nodes
from tryon_jax.training.principal import principal_coefficients
from tryon_jax.training.stages import (
    BatchSource,
    Distance,
    FineInput,
    Predictor,
    StageSet,
    StageWeights,
    displacement_scale,
    fine_sets,
    smooth_sets,
    stage_loss,
    validation_error,
)
from tryon_jax.tryon import Garment, Stage, TryOnModel, config_space, init_model, load_model, save_model
from tryon_jax.tryon.precision import cast_net


@dataclass(frozen=True)
class StageOptions:
    """Options of R_smooth's and R_fine's training."""

    loop: LoopOptions = field(
        default_factory=lambda: LoopOptions(steps=8000, optimiser="muon", learning_rate=1e-2, warmup=200)
    )
    garments: int = 4
    """Garments in a batch."""
    shapes: int = 16
    """Body shapes of each garment in a batch: with fields they share one pass of the network."""
    design_dropout: float = 0.1
    """Share of the garments in a batch whose nodes are not told the design, as those of a mesh without one."""
    designs: Literal["all", "paper"] = "all"
    """paper: the 19 training designs alone; all: the additional ones as well, where the dataset has them."""
    fresh: int = 0
    """Fresh topologies of each training garment that its simulated drapes are carried over to (see `carried`)."""
    fine_input: FineInput = "predicted"
    """What R_fine is trained on. predicted: M_smooth as R_smooth gives it, so that it also mends that network's errors;
    smoothed: the smoothed simulation (the paper)."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Arithmetic of the network while it is trained; weights, optimiser, losses and the result stay float32."""
    energy: float = 0.0
    """Weight of the cloth's energy in R_fine's loss (see `relative_energy`): keeps folds that ℓ² alone blurs."""
    distance: Distance = "plain"
    """Error that is minimised: the plain distance, or the squared one (see `displacement_error`)."""
    coefficients: Literal["principal", "trained"] = "principal"
    """Where the weights of the fields come from: the principal components of the drapes, before the network is trained
    (see `principal`), or training together with the network."""


def model_path(run: Path) -> Path:
    """Where a run keeps its model."""
    return run / "model.safetensors"


def training_names(root: Path, manifest: Manifest, designs: str = "all") -> list[str]:
    """Garments of a dataset that may be trained on and whose drapes on the mean body are there.

    Args:
        root: Folder of the dataset.
        manifest: Splits of designs and topologies.
        designs: "all", or "paper" for the 19 designs of the paper.
    """
    fabrics = read_config(root).fabrics
    names = manifest.training_garments(additional=designs == "all")
    return [n for n in names if has_drapes(root, n, fabrics)]


def dataset_checksum(root: Path, names: Sequence[str]) -> str:
    """SHA-256 over the contents of the files that a training run on these garments reads."""
    digest = hashlib.sha256((root / "config.json").read_bytes())
    for folder in ("meshes", "mean", "rays", "packed", "templates"):
        for path in sorted((root / folder).glob("[!.]*.npz")):
            if folder == "templates" or path.stem.split("_")[0] in names:
                digest.update(f"{folder}/{path.name}:".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def fit_mean(root: Path, run: Path, config: TryOnConfig, options: MeanTraining) -> TryOnModel:
    """Train R_mean and start the run's model.

    Args:
        root: Folder of the dataset.
        run: Folder of the run.
        config: Of the model.
        options: Of the training.
    """
    samples = load_templates(root, load_manifest())
    space = config_space(config)
    center, scale = np.asarray(space.mean), 0.5 * (np.asarray(space.maximum) - np.asarray(space.minimum))
    net, curve = train_mean(samples, center, scale, options)
    config = replace(config, mean_hidden=options.hidden)
    model = replace(init_model(jax.random.key(options.seed), config), mean=net)
    best = min(row["validation_mm"] for row in curve)
    record = {
        "designs": len(samples.designs),
        "validation_mm": best,
        "training_mm": 1e3 * mean_error(net, samples),
        "options": asdict(options),
    }
    write_text(run / "mean" / "curve.json", json.dumps({"curve": curve, **record}, indent=1) + "\n")
    save_model(model_path(run), model, {"mean": record, "platform": _platform()})
    return model


def load_samples(
    model: TryOnModel, root: Path, names: Sequence[str], prepared: Mapping[str, Garment] | None = None
) -> list[SimulatedGarment]:
    """Garments with their drapes, prepared for the model.

    Args:
        model: Its configuration and R_mean.
        root: Folder of the dataset.
        names: <design label>-<topology seed> of each garment.
        prepared: Garments by name that are prepared already.
    """
    fabrics, known = read_config(root).fabrics, prepared or {}
    listed = tqdm(names, desc="garments", mininterval=2)
    return [load_simulated(model, root, name, fabrics, known.get(name)) for name in listed]


def fit_smooth(
    root: Path,
    run: Path,
    options: StageOptions,
    samples: Sequence[SimulatedGarment] | None = None,
    limits: TimeLimits | None = None,
) -> TryOnModel:
    """Train R_smooth of a run whose R_mean is trained.

    Args:
        root: Folder of the dataset.
        run: Folder of the run.
        options: Of the training.
        samples: All garments of `training_names`, where they are loaded already.
        limits: Of the time that this call may take.

    Raises:
        OutOfTimeError: The deadline came; the same call continues.
    """
    model = load_model(model_path(run))
    manifest = load_manifest()
    names, samples = _training_samples(model, root, manifest, options, samples)
    sets, checksum = smooth_sets(samples, manifest), dataset_checksum(root, names)
    stage, record = fit_stage(model, "smooth", model.smooth, sets, run / "smooth", options, checksum, limits=limits)
    model = replace(model, smooth=stage)
    save_stage(run, model, "smooth", record)
    return model


def _training_samples(
    model: TryOnModel,
    root: Path,
    manifest: Manifest,
    options: StageOptions,
    samples: Sequence[SimulatedGarment] | None,
) -> tuple[list[str], list[SimulatedGarment]]:
    """Names of the simulated garments that are trained on, and them with their fresh topologies."""
    names = training_names(root, manifest, options.designs)
    loaded = load_samples(model, root, names) if samples is None else list(samples)
    return names, loaded + fresh_topologies(model, root, loaded, manifest, options.fresh)


def fit_fine(
    root: Path,
    run: Path,
    fabrics: Sequence[str],
    options: StageOptions,
    pool: Executor | None = None,
    samples: Sequence[SimulatedGarment] | None = None,
    limits: TimeLimits | None = None,
) -> TryOnModel:
    """Train R_fine of each fabric, for a run whose R_smooth is trained.

    Args:
        root: Folder of the dataset.
        run: Folder of the run.
        fabrics: Whose R_fine.
        options: Of each training.
        pool: Trains the fabrics side by side; without it one follows the other.
        samples: As in `fit_smooth`.
        limits: As in `fit_smooth`.

    Raises:
        OutOfTimeError: as in `fit_smooth`.
        ValueError: energies and fresh topologies are asked for at once: those have no rest state.
    """
    if options.energy and options.fresh:
        raise ValueError(f"energy = {options.energy} needs fresh = 0, not {options.fresh}: carried drapes do not rest")
    return fit_fabrics(run, fabrics, pool, _train_fine, "fine", root, run, options, samples, limits)


def _train_fine(
    fabric: str,
    root: Path,
    run: Path,
    options: StageOptions,
    samples: Sequence[SimulatedGarment] | None,
    limits: TimeLimits | None,
) -> tuple[Stage, dict[str, Any]]:
    model = load_model(model_path(run))
    if fabric in model.kriging:
        # Kriged drapes are those of a design: there is none without one.
        options = replace(options, design_dropout=0.0)
    sets, checksum = load_fine_sets(model, root, fabric, options, samples)
    folder, cloth = run / f"fine-{fabric}", load_fabric(fabric)
    return fit_stage(model, "fine", model.fine[fabric], sets, folder, options, checksum, cloth, limits)


def fit_fabrics(
    run: Path, fabrics: Sequence[str], pool: Executor | None, train: Callable[..., Any], name: str, *arguments: Any
) -> TryOnModel:
    """One stage for each fabric; results are put into the model by this process, as they come.

    Args:
        run: Folder of the run.
        fabrics: Whose stage.
        pool: Trains the fabrics side by side; without it one follows the other.
        train: Of a fabric and `arguments`, the trained stage and the record of its training; None where nothing is new.
        name: Of the training in the model's record, before the fabric's.
        arguments: Of `train`, after the fabric.
    """
    if pool is None:
        found = ((fabric, train(fabric, *arguments)) for fabric in fabrics)
    else:
        futures = {pool.submit(train, fabric, *arguments): fabric for fabric in fabrics}
        found = ((futures[future], future.result()) for future in as_completed(futures))
    for fabric, result in found:
        if result is not None:
            # Read again: another run of this program may have finished another fabric meanwhile.
            save_stage(run, with_fine(load_model(model_path(run)), fabric, result[0]), f"{name}-{fabric}", result[1])
    return load_model(model_path(run))


def load_fine_sets(
    model: TryOnModel,
    root: Path,
    fabric: str,
    options: StageOptions,
    samples: Sequence[SimulatedGarment] | None = None,
) -> tuple[list[StageSet], str]:
    """Samples of one fabric's R_fine and their checksum.

    Args:
        model: Its configuration and R_mean.
        root: Folder of the dataset.
        fabric: Name of the fabric.
        options: Of the training.
        samples: As in `fit_smooth`.
    """
    manifest = load_manifest()
    names, samples = _training_samples(model, root, manifest, options, samples)
    smooth_vertices = None
    if fabric in model.kriging:
        smooth_vertices = _starts(model, samples, manifest, fabric)
    elif options.fine_input == "predicted":
        predictor = Predictor(model.config, "smooth")
        smooth_vertices = [
            predictor(model.smooth, s.garment, s.betas) for s in tqdm(samples, desc="M_smooth", mininterval=2)
        ]
    cloths = [load_cloth(root, s) for s in samples] if options.energy else None
    return fine_sets(samples, manifest, fabric, smooth_vertices, cloths), dataset_checksum(root, names)


def _starts(
    model: TryOnModel, samples: Sequence[SimulatedGarment], manifest: Manifest, fabric: str
) -> list[Float[np.ndarray, "S N 3"]]:
    """Kriged drapes of all samples, those that are trained on without their own design."""
    kriging = model.kriging[fabric]
    # The process once more: a model does not keep what it takes to leave a design out.
    fit = KrigingFit(read_nodes(model, samples, manifest, fabric), kriging.shapes.config)
    return kriged_starts(model, kriging, fit.without_each_design(), samples, manifest, fabric)


def fit_stage(
    model: TryOnModel,
    kind: str,
    stage: Stage,
    sets: Sequence[StageSet],
    folder: Path,
    options: StageOptions,
    checksum: str,
    fabric: Fabric | None = None,
    limits: TimeLimits | None = None,
) -> tuple[Stage, dict[str, Any]]:
    """Train one stage, "smooth" or "fine", from the weights of `stage`; checkpoints and curve go to `folder`.

    Args:
        model: The model.
        kind: "smooth" or "fine".
        stage: Network and scale to start from.
        sets: Samples of each garment.
        folder: Where checkpoints and the curve are kept.
        options: Of the training.
        checksum: Of the samples.
        fabric: The stage's fabric, where the loss has energies.
        limits: Of the time that this call may take.

    Returns:
        The trained stage, and the record of its training.
    """
    stage = replace(stage, scale=jnp.asarray(displacement_scale(model.config, sets), jnp.float32))
    principal = stage.coefficients is not None and options.coefficients == "principal"
    if principal:
        known = principal_coefficients(model.config, stage, sets, options.loop.seed)
        stage = replace(stage, coefficients=known)
    no_design = config_space(model.config).middle
    source = BatchSource(sets, options.garments, options.shapes, no_design, options.design_dropout)
    predictor = Predictor(model.config, kind)

    def loss(weights: StageWeights, batch: Any) -> jax.Array:
        used = weights.of(stage)
        if options.precision == "bfloat16":
            used = replace(used, net=cast_net(used.net, jnp.bfloat16))
        return stage_loss(model.config, kind, used, batch, options.distance, options.energy, fabric)

    def evaluate(weights: StageWeights) -> float:
        return validation_error(predictor, weights.of(stage), sets)

    identity = {
        "stage": kind,
        "options": asdict(options),
        "config": stage_config(model.config, kind),
        "dataset": checksum,
        "parameters": count_parameters(stage),
    }
    loop = all_shapes_at_once(options.loop, model.config, options.shapes)
    weights = StageWeights(stage.net, None if principal else stage.coefficients)
    result = train_loop(weights, loss, source.draw, evaluate, folder, loop, identity, folder.name, limits=limits)
    record = {
        "garments": len(sets),
        "samples": int(sum(s.train.sum() for s in sets)),
        "validation_mm": min(row["validation"] for row in result.curve),
        "steps": result.curve[-1]["step"],
        "seconds": round(result.seconds),
        "options": asdict(options),
        "dataset": checksum,
        "platform": _platform(),
        "curve": [[row["step"], round(row["loss"], 4), round(row["validation"], 3)] for row in result.curve],
    }
    return result.params.of(stage), record


def stage_config(config: TryOnConfig, kind: str) -> dict[str, Any]:
    """What a stage's training depends on of the model's configuration: R_smooth is trained before drapes are kriged.

    Args:
        config: Of the model.
        kind: "smooth", "fine" or "collisions".
    """
    unused = ("kriging", "kriged_fine") if kind == "smooth" or config.kriging is None else ()
    return {name: value for name, value in store.config_record(config).items() if name not in unused}


def all_shapes_at_once(loop: LoopOptions, config: TryOnConfig, shapes: int) -> LoopOptions:
    """With fields, the network runs once for all bodies of a garment; on a CPU one garment follows the other.

    Args:
        loop: Options of the training.
        config: Of the model.
        shapes: Bodies of each garment in a batch.

    Returns:
        The options with `shapes_at_once` set where it was left open.
    """
    if config.conditioning == "node" or loop.shapes_at_once is not None:
        return loop
    return replace(loop, shapes_at_once=shapes if jax.default_backend() == "cpu" else 0)


def save_stage(run: Path, model: TryOnModel, name: str, result: dict[str, Any]) -> None:
    """Write the run's model, the record of its newest training after those that it continues.

    Args:
        run: Folder of the run.
        model: With the trained stage.
        name: Of the training: "smooth", "fine-<fabric>" or "collisions-<fabric>".
        result: Its record.
    """
    record = store.read_record(model_path(run)).get("training", {})
    earlier = record.get(name)
    record[name] = dict(result)
    if earlier is not None and "continues" not in result:
        again = all(earlier.get(key) == result.get(key) for key in ("options", "dataset"))
        before = earlier.get("continues") if again else earlier
        record[name] |= {"continues": before} if before else {}
    if name.startswith("fine-"):
        # These weights have not been through a collision step.
        record.pop(name.replace("fine-", "collisions-"), None)
    save_model(model_path(run), model, record)


def chain(record: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """A stage's trainings in their order: those that its record continues, then its own."""
    earlier = record.get("continues")
    return [*chain(earlier), record] if earlier else [record]


def _platform() -> dict[str, str]:
    return {"machine": platform.machine(), "python": platform.python_version(), "device": jax.devices()[0].device_kind}
