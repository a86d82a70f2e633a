"""A small data set on disk whose drapes are what a test says: errors of the experiments have known answers there."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np

from experiments.shared.evaluate import Pipeline, Prediction
from tests.experiments.tiny_garments import AREA, tiny_model
from tryon_jax.garment import load_manifest, placement, remesh
from tryon_jax.training.dataset import (
    STATISTICS,
    DatasetConfig,
    mean_path,
    mesh_path,
    open_dataset,
    ray_path,
    save_arrays,
)
from tryon_jax.training.garments import prepare_simulated
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import TryOnModel, config_space, init_model, save_model

FABRICS = ("gray-interlock", "white-dots-on-blk")
GARMENTS = ("tshirt-0", "tshirt-100", "unseen-tshirt-0")
"""A training garment, another topology of its design, and a design that no training sees."""
BETAS = np.array([[0.0, 0.0], [0.8, 0.0], [1.6, 0.0], [2.4, 0.0], [3.0, 0.0]], np.float32)
"""The mean body and one ray to its end."""
TEST = np.array([False, True, False, False, True])
"""Body shapes for tests; one of them is the end of the ray."""

Drapes = Callable[[str, str, np.ndarray, Prediction], np.ndarray]
"""Drapes [S, V, 3] of a garment, by its name, fabric, mean drape [V, 3] and the model's prediction, metres."""


def known_model() -> TryOnModel:
    """A trained R_mean; small, untrained networks for two fabrics, which displace by millimetres."""
    model = tiny_model()
    config = replace(model.config, fabrics=FABRICS)
    return replace(init_model(jax.random.key(1), config, body=model.body), mean=model.mean)


def write_known(root: Path, model: TryOnModel, drapes: Drapes, garments: tuple[str, ...] = GARMENTS) -> Path:
    """Write a data set of these drapes and return its folder; the rules keep every sample."""
    open_dataset(root, DatasetConfig(fabrics=FABRICS, target_area=AREA))
    manifest, pipeline = load_manifest(), Pipeline(model)
    for name in garments:
        label, seed = name.rsplit("-", 1)
        mesh = remesh(config_space(model.config), manifest.design(label), AREA, seed=int(seed))
        keys = ("faces", "uv", "faces_uv", "template_vertices", "template_weights")
        arrays = {key: getattr(mesh, key) for key in keys}
        save_arrays(mesh_path(root, name), arrays | {"design": mesh.design.values, "start": placement(mesh)})
        garment = prepare_simulated(model, root, name)
        samples: Any = SimpleNamespace(garment=garment, betas=BETAS)
        predicted = pipeline(samples, np.arange(len(BETAS)), FABRICS)
        for fabric in FABRICS:
            found = drapes(name, fabric, garment.mean_vertices, predicted[fabric]).astype(np.float32)
            origin = dict.fromkeys(STATISTICS, np.float64(0.0))
            save_arrays(mean_path(root, name, fabric), origin | {"vertices": found[0]})
            along = dict.fromkeys(STATISTICS, np.zeros(len(BETAS) - 1))
            along |= {"vertices": found[1:], "betas": BETAS[1:], "test": TEST[1:]}
            save_arrays(ray_path(root, name, fabric, 0), along)
    return root


def write_run(folder: Path, model: TryOnModel) -> Path:
    """Write the folder of a run with this model, and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    save_model(model_path(folder), model, {stage: {} for stage in ("mean", "smooth", *(f"fine-{f}" for f in FABRICS))})
    return folder
