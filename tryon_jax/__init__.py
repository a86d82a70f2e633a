"""Parametric virtual try-on in JAX: from a sewing pattern, a body shape and a fabric to the draped garment."""

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
from tryon_jax.types import Body
from tryon_jax.wear.session import Session

__version__ = "0.1.0"

__all__ = [
    "Body",
    "ClosedSurface",
    "DesignSpace",
    "DrapeFields",
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
    "face_normals",
    "init_model",
    "load_body",
    "load_design_space",
    "load_model",
    "load_pretrained",
    "load_smpl",
    "mean_drape",
    "measure_body",
    "pose_body",
    "prepare",
    "push_out",
    "remesh",
    "save_model",
    "shape_body",
    "stack_garments",
    "vertex_normals",
]
