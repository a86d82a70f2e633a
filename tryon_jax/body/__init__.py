"""Parametric bodies with SMPL's interface: shape, pose, measurements, the embedded bodies and SMPL files."""

from tryon_jax.body.embedded import load_body
from tryon_jax.body.from_measurements import MeasurementFit, betas_from_measurements
from tryon_jax.body.landmarks import Landmarks, find_landmarks
from tryon_jax.body.measurements import MEASUREMENTS, measure_body
from tryon_jax.body.normals import face_normals, vertex_normals
from tryon_jax.body.pose import pose_body
from tryon_jax.body.shape import check_betas, full_betas, shape_body
from tryon_jax.body.smpl import load_smpl

__all__ = [
    "MEASUREMENTS",
    "Landmarks",
    "MeasurementFit",
    "betas_from_measurements",
    "check_betas",
    "face_normals",
    "find_landmarks",
    "full_betas",
    "load_body",
    "load_smpl",
    "measure_body",
    "pose_body",
    "shape_body",
    "vertex_normals",
]
