"""One stage trained from its samples: what R_smooth, every R_fine and R_stance have in common."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from tryon_jax.nets import store
from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.unet import count_parameters
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.training.batches import BatchSource
from tryon_jax.training.loop import LoopOptions, TimeLimits, train_loop
from tryon_jax.training.principal import principal_coefficients
from tryon_jax.training.run_folder import platform_record
from tryon_jax.training.stage_loss import StageWeights, stage_loss
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_prediction import Predictor, validation_error
from tryon_jax.training.stage_sets import StageSet, displacement_scale
from tryon_jax.tryon import Stage, TryOnModel, config_space
from tryon_jax.tryon.precision import cast_net


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
        return stage_loss(
            model.config,
            kind,
            used,
            batch,
            options.distance,
            options.energy,
            fabric,
            edges=options.edges,
            normals=options.normals,
        )

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
        "platform": platform_record(),
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
