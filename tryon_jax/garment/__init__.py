"""Sewing patterns: design spaces, panels and seams, sewing, the template, and topology optimisation φ.

Host side only (NumPy and SciPy); nothing here is traced or differentiated.
"""

from tryon_jax.garment.design import Design, DesignSpace, load_design_space
from tryon_jax.garment.layout import Layout, load_layout
from tryon_jax.garment.mesh import GarmentMesh, SewnMesh, place_on_template
from tryon_jax.garment.placement import placement
from tryon_jax.garment.remesh import TARGET_AREA, remesh
from tryon_jax.garment.template import DENSE_VERTICES, TEMPLATE_VERTICES, build_template

__all__ = [
    "DENSE_VERTICES",
    "TARGET_AREA",
    "TEMPLATE_VERTICES",
    "Design",
    "DesignSpace",
    "GarmentMesh",
    "Layout",
    "SewnMesh",
    "build_template",
    "load_design_space",
    "load_layout",
    "place_on_template",
    "placement",
    "remesh",
]
