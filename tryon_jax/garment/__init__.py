"""Sewing patterns: design spaces, panels and seams, sewing, the template, and topology optimisation φ.

Host side only (NumPy and SciPy); nothing here is traced or differentiated.
"""

from tryon_jax.garment.dense import DENSE_VERTICES, DenseTemplate, dense_template
from tryon_jax.garment.design import Design, DesignSpace, load_design_space
from tryon_jax.garment.layout import Layout
from tryon_jax.garment.layout_file import load_layout
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.garment.mesh import GarmentMesh, SewnMesh, place_on_template
from tryon_jax.garment.placement import placement
from tryon_jax.garment.remesh import TARGET_AREA, remesh
from tryon_jax.garment.template import TEMPLATE_VERTICES, build_template

__all__ = [
    "DENSE_VERTICES",
    "TARGET_AREA",
    "TEMPLATE_VERTICES",
    "DenseTemplate",
    "Design",
    "DesignSpace",
    "GarmentMesh",
    "Layout",
    "Manifest",
    "SewnMesh",
    "build_template",
    "dense_template",
    "load_design_space",
    "load_layout",
    "load_manifest",
    "place_on_template",
    "placement",
    "remesh",
]
