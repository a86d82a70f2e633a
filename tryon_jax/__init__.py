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
from tryon_jax.garment import load_design_space, remesh
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

__version__ = "0.1.0"

__all__ = [
    "DrapeFields",
    "Garment",
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
    "remesh",
    "save_model",
    "shape_body",
    "stack_garments",
    "vertex_normals",
]
