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

__version__ = "0.1.0"

__all__ = [
    "betas_from_measurements",
    "face_normals",
    "load_body",
    "load_smpl",
    "measure_body",
    "pose_body",
    "shape_body",
    "vertex_normals",
]
