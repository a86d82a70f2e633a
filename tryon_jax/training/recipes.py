"""The steps from a simulated dataset to a trained model; each continues from what its folder holds (`run_folder`).

A stage starts from the weights in the model: where RUN holds nothing but a trained model, it is trained further, and
the record of its earlier training stays inside the new one.
"""

import json
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from tryon_jax.files.atomic import write_text
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.nets.config import TryOnConfig
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.collisions import with_fine
from tryon_jax.training.garments import SimulatedGarment, load_cloth
from tryon_jax.training.kriging import KrigingFit, kriged_starts
from tryon_jax.training.loop import TimeLimits
from tryon_jax.training.mean import MeanTraining, load_templates, mean_error, train_mean
from tryon_jax.training.node_drapes import read_nodes
from tryon_jax.training.run_folder import model_path, platform_record, save_stage
from tryon_jax.training.stage_fit import fit_stage
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_prediction import Predictor
from tryon_jax.training.stage_sets import StageSet, fine_sets, smooth_sets
from tryon_jax.training.training_set import dataset_checksum, training_samples
from tryon_jax.tryon import Stage, TryOnModel, config_space, init_model, load_model, save_model


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
    save_model(model_path(run), model, {"mean": record, "platform": platform_record()})
    return model


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
    names, samples = training_samples(model, root, manifest, options, samples)
    sets, checksum = smooth_sets(samples, manifest), dataset_checksum(root, names)
    stage, record = fit_stage(model, "smooth", model.smooth, sets, run / "smooth", options, checksum, limits=limits)
    model = replace(model, smooth=stage)
    save_stage(run, model, "smooth", record)
    return model


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
    names, samples = training_samples(model, root, manifest, options, samples)
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
    assert model.config.kriging is not None
    fit = KrigingFit(read_nodes(model, samples, manifest, fabric), model.config.kriging)
    return kriged_starts(model, kriging, fit.without_each_design(), samples, manifest, fabric)
