"""The step of a training run between R_mean and R_fine: kriged drapes of designs in each fabric."""

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import jax
from tqdm import tqdm

from tryon_jax.garment.manifest import load_manifest
from tryon_jax.nets import store
from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.kriging import KrigingFit, kriging_error
from tryon_jax.training.node_drapes import read_nodes
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.training_set import dataset_checksum, load_samples, training_names
from tryon_jax.tryon import TryOnModel, init_model, load_model, save_model


def fit_kriging(
    root: Path,
    run: Path,
    fabrics: Sequence[str],
    config: KrigingConfig,
    seed: int = 0,
    samples: Sequence[SimulatedGarment] | None = None,
) -> TryOnModel:
    """Krige the drapes of designs in each fabric, for a run whose R_mean is trained: R_fine then starts anew from them.

    Args:
        root: Folder of the dataset.
        run: Folder of the run.
        fabrics: Whose drapes: all single ones of the run's model.
        config: Of the processes.
        seed: Of R_fine's weights before its training.
        samples: As in `fit_smooth`.
    """
    model, manifest = load_model(model_path(run)), load_manifest()
    names = training_names(root, manifest)
    samples = load_samples(model, root, names) if samples is None else samples
    model = replace(model, config=replace(model.config, kriging=config))
    record = store.read_record(model_path(run)).get("training", {})
    found = {}
    for fabric in tqdm(fabrics, desc="kriging"):
        began = time.monotonic()
        drapes = read_nodes(model, samples, manifest, fabric)
        found[fabric] = KrigingFit(drapes, config).kriging
        record[f"kriging-{fabric}"] = {
            "garments": len(drapes.rows),
            "samples": len(drapes.fields),
            "validation_mm": kriging_error(model, found[fabric], samples, manifest, fabric),
            "seconds": round(time.monotonic() - began),
            "options": asdict(config),
            "dataset": dataset_checksum(root, names),
        }
        for name in ("fine", "collisions"):
            # Of weights that are not kept.
            record.pop(f"{name}-{fabric}", None)
    fresh = init_model(jax.random.key(seed), model.config, body=model.body).fine
    model = replace(model, kriging=found, fine=model.fine | {fabric: fresh[fabric] for fabric in fabrics})
    save_model(model_path(run), model, record)
    return model
