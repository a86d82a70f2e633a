"""The R_fine of all fabrics as a file of its own, added to a model whose R_mean and R_smooth it was trained on."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax

from tryon_jax.nets import store
from tryon_jax.nets.config import ADDED_LATER, TryOnConfig
from tryon_jax.tryon.model import ALL_FABRICS, TryOnModel, init_networks

_SHARED = ("shared_fabrics", "fabric_functions", "fabric_numbers")
"""Entries of the configuration that are of the R_fine of all fabrics."""
_OTHERS = ("fabrics", "kriging", "kriged_fine")
"""Those that are of other networks."""


def save_shared_fine(
    path: str | Path, model: TryOnModel, training: Mapping[str, Any] | None = None, half: bool = False
) -> None:
    """Write a model's R_fine of all fabrics, without the rest.

    Args:
        path: File to write.
        model: The model.
        training: Record of its training, plain JSON values.
        half: Store the network's weights in half precision.

    Raises:
        ValueError: The model has none.
    """
    if ALL_FABRICS not in model.fine:
        raise ValueError("this model has no R_fine of all fabrics")
    record = {"config": store.config_record(model.config), "basis": _basis(model), "training": dict(training or {})}
    store.save_store(path, {ALL_FABRICS: model.fine[ALL_FABRICS]}, record, half=half)


def add_shared_fine(model: TryOnModel, path: str | Path) -> TryOnModel:
    """The model with the R_fine of all fabrics of a file beside its own of single fabrics.

    Args:
        model: Whose R_mean and R_smooth the R_fine was trained on.
        path: From `save_shared_fine`.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, or was trained on another R_mean or R_smooth.
    """
    record = store.read_record(path)
    found = ADDED_LATER | dict(record.get("config", {}))
    shared = {name: tuple(v) if isinstance(v := found.get(name), list) else v for name in _SHARED}
    config: TryOnConfig = dataclasses.replace(model.config, **shared)
    wanted = store.config_record(config) | {name: found.get(name) for name in _OTHERS}
    faults = store.compare_records({"config": found}, {"config": wanted})
    if record.get("basis") != _basis(model):
        faults.append("R_mean and R_smooth are not those that it was trained on")
    if faults:
        raise ValueError(f"{str(path)!r} does not fit the model: " + "; ".join(faults))
    alone = dataclasses.replace(config, fabrics=(), kriging=None)
    fine = store.load_tree(path, lambda: init_networks(jax.random.key(0), alone, body=model.body).fine)
    return dataclasses.replace(model, fine={**model.fine, **fine}, config=config)


def _basis(model: TryOnModel) -> str:
    """Fingerprint of what every R_fine builds on."""
    return store.hash_arrays(*jax.tree.leaves((model.mean, model.smooth)))
