"""Training one R_fine of all fabrics: a dataset of few fabrics and many garments, and one of many fabrics and few.

The fields are weighted by products of a coefficient of the body and a function of the fabric's numbers. Both come from
the simulated drapes before the network is trained: the coefficients as in `principal`, and the fabric functions as the
principal components over the trained fabrics, carried on to others by kriging (`nets.fabric_functions`).
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float
from tqdm import tqdm

from tryon_jax.garment.manifest import load_manifest
from tryon_jax.nets import store
from tryon_jax.nets.fabric_functions import FabricFunctions, fit_fabric_functions
from tryon_jax.physics.fabric_numbers import fabric_numbers
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.dataset import read_config
from tryon_jax.training.garments import load_simulated, prepare_simulated
from tryon_jax.training.principal import EVERY, principal_functions
from tryon_jax.training.run_folder import model_path, save_stage
from tryon_jax.training.stage_fit import fit_stage
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_prediction import Predictor
from tryon_jax.training.stage_sets import StageSet, displacements, fine_sets
from tryon_jax.training.training_set import dataset_checksum, load_samples, training_names
from tryon_jax.tryon import ALL_FABRICS, TryOnModel, init_model, load_model, save_model


def fit_all_fabrics(
    root: Path,
    fabric_root: Path,
    run: Path,
    start: Path,
    fabrics: Sequence[str],
    functions: int,
    options: StageOptions,
) -> TryOnModel:
    """Train one R_fine of all fabrics, beside the R_mean and R_smooth of another run.

    Args:
        root: Folder of the dataset with few fabrics and many garments.
        fabric_root: Folder of the dataset with many fabrics.
        run: Folder of this run.
        start: Model whose R_mean and R_smooth are taken.
        fabrics: Names of the fabrics that are trained on; no drape of another one is read.
        functions: Fabric functions J, at most as many as fabrics.
        options: Of the training.

    Raises:
        ValueError: A fabric is not in the dataset, or there are more functions than fabrics.
    """
    check_fabrics(root, fabric_root, fabrics, functions)
    if not model_path(run).exists():
        _begin(run, start, fabrics, functions, options.loop.seed)
    model = load_model(model_path(run))
    by_fabric, checksum = _load_by_fabric(model, root, fabric_root, options)
    stage = model.fine[ALL_FABRICS]
    known = principal_fabrics(model, {fabric: many for fabric, (_, many) in by_fabric.items()}, functions)
    stage = replace(stage, fabrics=jax.tree.map(np.asarray, known))
    sets = [s for few, many in by_fabric.values() for s in (*few, *many)]
    folder = run / f"fine-{ALL_FABRICS}"
    stage, record = fit_stage(model, "fine", stage, sets, folder, options, checksum)
    model = replace(model, fine={ALL_FABRICS: stage})
    save_stage(run, model, f"fine-{ALL_FABRICS}", record | {"fabrics": list(fabrics)})
    return model


def check_fabrics(root: Path, fabric_root: Path, fabrics: Sequence[str], functions: int) -> None:
    """Refuse what cannot be trained.

    Args:
        root: Folder of the dataset with few fabrics and many garments.
        fabric_root: Folder of the dataset with many fabrics.
        fabrics: Names of the fabrics that are to be trained on.
        functions: Fabric functions.

    Raises:
        ValueError: As in `fit_all_fabrics`.
    """
    there = set(read_config(fabric_root).fabrics)
    missing = [fabric for fabric in fabrics if fabric not in there]
    missing += [fabric for fabric in read_config(root).fabrics if fabric not in fabrics]
    if missing:
        raise ValueError(f"fabrics {missing} must be both trained on and simulated in {str(fabric_root)!r}")
    if not 1 <= functions <= len(fabrics):
        raise ValueError(f"functions = {functions} must be 1 to {len(fabrics)}, the number of trained fabrics")


def load_all_fabrics(
    model: TryOnModel, root: Path, fabric_root: Path, options: StageOptions
) -> tuple[list[StageSet], str]:
    """Samples of the R_fine of all fabrics, and the checksum of both datasets.

    Args:
        model: Its configuration, R_mean and R_smooth.
        root: As in `fit_all_fabrics`.
        fabric_root: As there.
        options: Of the training.
    """
    by_fabric, checksum = _load_by_fabric(model, root, fabric_root, options)
    return [s for few, many in by_fabric.values() for s in (*few, *many)], checksum


def principal_fabrics(model: TryOnModel, sets: Mapping[str, Sequence[StageSet]], functions: int) -> FabricFunctions:
    """The fabric functions that suit the drapes of the same garments in all trained fabrics.

    Args:
        model: Its configuration.
        sets: Samples of the same garments for each fabric.
        functions: How many, J.
    """
    fabrics = list(sets)
    columns = [_columns(model, [sets[fabric][k] for fabric in fabrics]) for k in range(len(sets[fabrics[0]]))]
    drapes = np.concatenate([drape for drape, _ in columns], axis=1)
    known = np.concatenate([there for _, there in columns], axis=1)
    numbers = np.stack([np.asarray(fabric_numbers(load_fabric(fabric))) for fabric in fabrics])
    return fit_fabric_functions(numbers, principal_functions(drapes, known, functions))


def _columns(
    model: TryOnModel, of_garment: Sequence[StageSet]
) -> tuple[Float[np.ndarray, "T D"], Bool[np.ndarray, "T D"]]:
    """Displacements of one garment in every fabric at the shapes that half of them have, metres."""
    places = [{tuple(s.betas[row]): row for row in np.flatnonzero(s.train)} for s in of_garment]
    shapes = sorted({shape for place in places for shape in place})
    common = [shape for shape in shapes if 2 * sum(shape in place for place in places) >= len(places)]
    vertices = np.flatnonzero(np.asarray(of_garment[0].garment.graph.mask))[::EVERY]
    drapes = np.zeros((len(of_garment), len(common), len(vertices), 3), np.float32)
    known = np.zeros((len(of_garment), len(common)), bool)
    for k, (s, place) in enumerate(zip(of_garment, places, strict=True)):
        here = [i for i, shape in enumerate(common) if shape in place]
        rows = np.array([place[common[i]] for i in here], int)
        drapes[k, here] = displacements(model.config, s, rows)[:, vertices] / np.sqrt(len(vertices))
        known[k, here] = True
    flat = drapes.reshape(len(of_garment), -1)
    return flat, np.broadcast_to(known[:, :, None, None], drapes.shape).reshape(flat.shape)


def _begin(run: Path, start: Path, fabrics: Sequence[str], functions: int, seed: int) -> None:
    """The run's model: R_mean and R_smooth of another one, and an R_fine of all fabrics that knows nothing yet."""
    old = load_model(start)
    config = replace(old.config, fabrics=(), kriging=None, shared_fabrics=tuple(fabrics), fabric_functions=functions)
    model = replace(init_model(jax.random.key(seed), config, body=old.body), mean=old.mean, smooth=old.smooth)
    training = store.read_record(start).get("training", {})
    kept = {name: training[name] for name in ("mean", "smooth") if name in training}
    save_model(model_path(run), model, kept)


def _load_by_fabric(
    model: TryOnModel, root: Path, fabric_root: Path, options: StageOptions
) -> tuple[dict[str, tuple[list[StageSet], list[StageSet]]], str]:
    """For each fabric the sets of the first dataset (none where it has not the fabric) and of the second."""
    manifest, predictor = load_manifest(), Predictor(model.config, "smooth")

    def sets_of(samples: Sequence[Any], fabric: str, smooth: Sequence[np.ndarray]) -> list[StageSet]:
        numbers = np.asarray(fabric_numbers(load_fabric(fabric)), np.float32)
        return fine_sets(samples, manifest, fabric, smooth, numbers=numbers)

    names = training_names(root, manifest, options.designs)
    samples = load_samples(model, root, names)
    smooth = [predictor(model.smooth, s.garment, s.betas) for s in tqdm(samples, desc="M_smooth", mininterval=2)]
    few = {fabric: sets_of(samples, fabric, smooth) for fabric in read_config(root).fabrics}
    here = training_names(fabric_root, manifest, options.designs)
    garments = {name: prepare_simulated(model, fabric_root, name) for name in here}
    found: dict[str, tuple[list[StageSet], list[StageSet]]] = {}
    for fabric in tqdm(model.config.shared_fabrics, desc="fabrics", mininterval=2):
        # One fabric at a time: a drape is of use in one whether or not it is at rest in another.
        own = [load_simulated(model, fabric_root, name, (fabric,), garments[name]) for name in here]
        predicted = [predictor(model.smooth, s.garment, s.betas) for s in own]
        found[fabric] = (few.get(fabric, []), sets_of(own, fabric, predicted))
    both = [dataset_checksum(root, names), dataset_checksum(fabric_root, here)]
    return found, hashlib.sha256(" ".join(both).encode()).hexdigest()
