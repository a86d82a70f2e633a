"""Parametric virtual try-on in JAX: from a sewing pattern, a body shape and a fabric to the draped garment."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tryon_jax.body import (
        betas_from_measurements,
        face_normals,
        load_body,
        load_smpl,
        measure_body,
        pose_body,
        shape_body,
        vertex_normals,
    )
    from tryon_jax.contact.push_out import push_out
    from tryon_jax.contact.signed_distance import ClosedSurface
    from tryon_jax.garment import DesignSpace, load_design_space, remesh
    from tryon_jax.nets.config import TryOnConfig
    from tryon_jax.physics.fabric_numbers import fabric_numbers
    from tryon_jax.physics.fabrics import load_fabric
    from tryon_jax.tryon import (
        DrapeFields,
        Garment,
        TryOnModel,
        apply_fields,
        body_contact,
        drape,
        drape_fields,
        drape_stages,
        init_model,
        load_model,
        load_pretrained,
        mean_drape,
        prepare,
        save_model,
        stack_garments,
    )
    from tryon_jax.tryon.stance import stance_fields, stand
    from tryon_jax.types import Body
    from tryon_jax.wear.session import Session
    from tryon_jax.wear.stance import lower_arms
    from tryon_jax.wear.tailor import FitTarget, tailor

__version__ = "0.1.0"

__all__ = [
    "Body",
    "ClosedSurface",
    "DesignSpace",
    "DrapeFields",
    "FitTarget",
    "Garment",
    "Session",
    "TryOnConfig",
    "TryOnModel",
    "apply_fields",
    "betas_from_measurements",
    "body_contact",
    "drape",
    "drape_fields",
    "drape_stages",
    "fabric_numbers",
    "face_normals",
    "init_model",
    "load_body",
    "load_design_space",
    "load_fabric",
    "load_model",
    "load_pretrained",
    "load_smpl",
    "lower_arms",
    "mean_drape",
    "measure_body",
    "pose_body",
    "prepare",
    "push_out",
    "remesh",
    "save_model",
    "shape_body",
    "stack_garments",
    "stance_fields",
    "stand",
    "tailor",
    "vertex_normals",
]

# Where each public name lives. It is imported when it is first used: `import tryon_jax` alone takes milliseconds, and a
# program pays for what it needs.
_HOMES = {
    "Body": "tryon_jax.types",
    "ClosedSurface": "tryon_jax.contact.signed_distance",
    "DesignSpace": "tryon_jax.garment",
    "DrapeFields": "tryon_jax.tryon",
    "FitTarget": "tryon_jax.wear.tailor",
    "Garment": "tryon_jax.tryon",
    "Session": "tryon_jax.wear.session",
    "TryOnConfig": "tryon_jax.nets.config",
    "TryOnModel": "tryon_jax.tryon",
    "apply_fields": "tryon_jax.tryon",
    "betas_from_measurements": "tryon_jax.body",
    "body_contact": "tryon_jax.tryon",
    "drape": "tryon_jax.tryon",
    "drape_fields": "tryon_jax.tryon",
    "drape_stages": "tryon_jax.tryon",
    "fabric_numbers": "tryon_jax.physics.fabric_numbers",
    "face_normals": "tryon_jax.body",
    "init_model": "tryon_jax.tryon",
    "load_body": "tryon_jax.body",
    "load_design_space": "tryon_jax.garment",
    "load_fabric": "tryon_jax.physics.fabrics",
    "load_model": "tryon_jax.tryon",
    "load_pretrained": "tryon_jax.tryon",
    "load_smpl": "tryon_jax.body",
    "lower_arms": "tryon_jax.wear.stance",
    "mean_drape": "tryon_jax.tryon",
    "measure_body": "tryon_jax.body",
    "pose_body": "tryon_jax.body",
    "prepare": "tryon_jax.tryon",
    "push_out": "tryon_jax.contact.push_out",
    "remesh": "tryon_jax.garment",
    "save_model": "tryon_jax.tryon",
    "shape_body": "tryon_jax.body",
    "stack_garments": "tryon_jax.tryon",
    "stance_fields": "tryon_jax.tryon.stance",
    "stand": "tryon_jax.tryon.stance",
    "tailor": "tryon_jax.wear.tailor",
    "vertex_normals": "tryon_jax.body",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'tryon_jax' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
