"""R_stance as a file of its own, added to a model of the same body, pattern and graphs."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax

from tryon_jax.nets import store
from tryon_jax.nets.config import ADDED_LATER, TryOnConfig, stance_config
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.tryon.model import StanceNetwork, TryOnModel
from tryon_jax.tryon.stance import init_stance
from tryon_jax.types import Body

_OWN = ("shared_fabrics", "fabric_functions", "fabric_numbers", "fields", "coefficient_widths", "beta_periods")
"""Entries of the configuration in which R_stance may differ from the model, beside its sizes."""
_OTHERS = ("smooth", "kriging", "kriged_fine")
"""Those that are of other networks."""


def save_stance(
    path: str | Path,
    network: StanceNetwork,
    body: Body,
    training: Mapping[str, Any] | None = None,
    half: bool = False,
) -> None:
    """Write R_stance.

    Args:
        path: File to write.
        network: R_stance.
        body: The body that it was trained on.
        training: Record of its training, plain JSON values.
        half: Store the network's weights in half precision.
    """
    record = {
        "config": store.config_record(network.config),
        "body": {"name": body.name, "hash": store.hash_body(body)},
        "training": dict(training or {}),
    }
    store.save_store(path, network.stage, record, half=half)


def add_stance(model: TryOnModel, path: str | Path) -> TryOnModel:
    """The model with the R_stance of a file.

    Args:
        model: Of the same body, with graphs like those that R_stance was trained on.
        path: From `save_stance`.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, or was trained for another body or other graphs.
    """
    record = store.read_record(path)
    record["config"] = found = ADDED_LATER | dict(record.get("config", {}))
    own: dict[str, Any] = {name: tuple(v) if isinstance(v := found.get(name), list) else v for name in _OWN}
    fine: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in dict(found.get("fine") or {}).items()}
    if set(fine) != {field.name for field in dataclasses.fields(UNetConfig)}:
        raise ValueError(f"{str(path)!r} has no sizes of R_stance")
    config: TryOnConfig = stance_config(model.config, fine=UNetConfig(**fine), **_with_fabrics(own))
    wanted = {
        "config": store.config_record(config) | {name: found.get(name) for name in _OTHERS},
        "body": {"name": model.body.name, "hash": store.hash_body(model.body)},
    }
    if faults := store.compare_records(record, wanted):
        raise ValueError(f"{str(path)!r} does not fit the model: " + "; ".join(faults))
    stage = store.load_tree(path, lambda: init_stance(jax.random.key(0), config, model.body).stage)
    return dataclasses.replace(model, stance=StanceNetwork(stage, config))


def _with_fabrics(own: dict[str, Any]) -> dict[str, Any]:
    """Keyword arguments of `stance_config`."""
    rest = {name: value for name, value in own.items() if name != "shared_fabrics"}
    return {"fabrics": own["shared_fabrics"] or (), **rest}
