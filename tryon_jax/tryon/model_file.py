"""Models as safetensors files: weights with a record of what they were made for, checked when read."""

import dataclasses
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import jax

from tryon_jax.body.embedded import load_body
from tryon_jax.checks import check_choice
from tryon_jax.nets import store
from tryon_jax.nets.config import ADDED_LATER, SMALL, TryOnConfig
from tryon_jax.nets.kernel_factor import with_factors, without_factors
from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.tryon.model import TryOnModel, config_space, init_networks, keep_off_skin, model_parameters
from tryon_jax.tryon.shared_fine import add_shared_fine
from tryon_jax.tryon.stance_file import add_stance
from tryon_jax.types import Body

SHARED = "-fabrics"
"""Ends the name of a file with the R_fine of all fabrics of a pretrained model."""
STANCE = "-stance"
"""The same with R_stance."""

_BEFORE_FIELDS = ADDED_LATER | {
    "beta_extent": [3.0, 2.0],
    "conditioning": "node",
    "fields": 24,
    "coefficient_widths": [64, 64],
    "beta_periods": [8.0, 4.0, 2.0],
    "wavelengths": [],
    "design_features": False,
    "num_parameters": 3,
    "laplacian": "symmetric",
    "shared_fabrics": [],
    "fabric_functions": 6,
    "fabric_numbers": 4,
    "kriging": None,
    "kriged_fine": store.config_record(SMALL.kriged_fine),
}
"""Defaults for files that were written before networks predicted fields, saw the fabric, or started from kriged
drapes."""


def save_model(
    path: str | Path, model: TryOnModel, training: Mapping[str, Any] | None = None, half: bool = False
) -> None:
    """Write parameters, configuration, body and pattern fingerprints and a training record to a safetensors file.

    `half` stores the networks' weights in half precision.

    Args:
        path: File to write.
        model: The model.
        training: Record of its training, plain JSON values.
        half: Store the networks' weights in half precision.
    """
    record = _record(model.config, model.body) | {"training": dict(training or {})}
    store.save_store(path, _stored(model), record, half=half)


def load_model(path: str | Path, body: Body | None = None) -> TryOnModel:
    """Read a model written by `save_model`.

    Args:
        path: A safetensors file.
        body: The body it was made for, where that is not embedded.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no store, damaged, or made for another body, pattern or version; the difference is named.
    """
    record = store.read_record(path)
    record["config"] = _BEFORE_FIELDS | record.get("config", {})
    config = _config_from_record(record["config"])
    body = body or load_body(config.body)
    faults = store.compare_records(record, _record(config, body))
    if faults:
        raise ValueError(f"{str(path)!r} was made for something else: " + "; ".join(faults))
    parameters = store.load_tree(path, lambda: _stored(init_networks(jax.random.key(0), config, body=body)))
    parameters["kriging"] = {fabric: with_factors(kriging) for fabric, kriging in parameters["kriging"].items()}
    return keep_off_skin(TryOnModel(**parameters, body=body, config=config))


def load_pretrained(name: str = "small") -> TryOnModel:
    """The model that comes with the library: trained weights, body and pattern, nothing to download.

    "small", the default, has kriged drapes of designs and an R_fine for each of two fabrics, an R_fine for all fabrics
    and meshes, and R_stance; "paper-form" is the paper's.

    Raises:
        ValueError: there is no model of that name.
    """
    folder = pretrained_path(name).parent
    files = sorted(path.stem for path in folder.glob("*.safetensors"))
    check_choice("pretrained model", name, [file for file in files if not file.endswith((SHARED, STANCE))])
    model = load_model(pretrained_path(name))
    for suffix, add in ((SHARED, add_shared_fine), (STANCE, add_stance)):
        if name + suffix in files:
            model = add(model, pretrained_path(name + suffix))
    return model


def pretrained_path(name: str) -> Path:
    """Where the package keeps weights of this name."""
    return Path(str(resources.files("tryon_jax") / "data" / "models" / f"{name}.safetensors"))


def _stored(model: TryOnModel) -> dict[str, Any]:
    parameters = model_parameters(model)
    return parameters | {"kriging": {fabric: without_factors(k) for fabric, k in parameters["kriging"].items()}}


def _record(config: TryOnConfig, body: Body) -> dict[str, Any]:
    space = config_space(config)
    return {
        "config": store.config_record(config),
        "body": {"name": body.name, "hash": store.hash_body(body)},
        "pattern": {
            "layout": config.layout,
            "parameters": list(space.names),
            "hash": store.hash_arrays(space.minimum, space.mean, space.maximum),
        },
        "units": {"length": "m", "angle": "rad"},
    }


def _config_from_record(record: Mapping[str, Any]) -> TryOnConfig:
    """The configuration of a stored record, lists back to tuples; raises naming unknown or missing fields."""

    def build(cls: type, values: Mapping[str, Any], where: str) -> Any:
        names = [f.name for f in dataclasses.fields(cls)]
        if set(names) != set(values):
            raise ValueError(f"{where} has other fields than this version: {sorted(set(names) ^ set(values))}")
        return cls(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})

    values = dict(record)
    for part in ("smooth", "fine", "kriged_fine"):
        if not isinstance(values.get(part), Mapping):
            raise ValueError(f"the stored configuration has no field {part!r}")
        values[part] = build(UNetConfig, values[part], f"the stored configuration of {part!r}")
    if values.get("kriging") is not None:
        values["kriging"] = build(KrigingConfig, values["kriging"], "the stored configuration of 'kriging'")
    return build(TryOnConfig, values, "the stored configuration")
