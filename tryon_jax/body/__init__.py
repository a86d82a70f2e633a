"""Parametric bodies with SMPL's interface: shape, pose, measurements, the embedded bodies and SMPL files."""

from tryon_jax.body.embedded import load_body
from tryon_jax.body.normals import face_normals, vertex_normals
from tryon_jax.body.pose import pose_body
from tryon_jax.body.shape import check_betas, shape_body
from tryon_jax.body.smpl import load_smpl

__all__ = ["check_betas", "face_normals", "load_body", "load_smpl", "pose_body", "shape_body", "vertex_normals"]
