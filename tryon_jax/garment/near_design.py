"""A garment mesh of a design from that of a near one: the same triangles on a moved pattern."""

from dataclasses import replace

import numpy as np

from tryon_jax.garment.design import Design, DesignSpace
from tryon_jax.garment.mesh import GarmentMesh
from tryon_jax.garment.pattern_derivative import carry_pattern
from tryon_jax.garment.remesh import MAX_DISTORTION
from tryon_jax.mesh.quality import measure_quality, signed_areas

MOST_DENSITY_CHANGE = 0.1
"""Change of the mean area of the triangles, over T_area, up to which a moved mesh stands for one made anew."""


def mesh_of_near_design(
    space: DesignSpace, mesh: GarmentMesh, design: Design, max_distortion: float = MAX_DISTORTION
) -> GarmentMesh | None:
    """The mesh with its pattern moved to another design, in a fraction of the time of `remesh`; host side.

    Samples on outlines keep their fraction of their edge, and with it their place on the template; points inside keep
    the template triangle that they lay in, which is right up to how unlike the two maps move them.

    Args:
        space: The design space that the mesh was made in.
        mesh: From `remesh`, not moved before.
        design: Another design in it.
        max_distortion: T_dist, as for `remesh`.

    Returns:
        The mesh; None where the design is too far: a triangle turns over, T_dist is not kept, or the mean area is off
        T_area by more than `MOST_DENSITY_CHANGE` of it.

    Raises:
        ValueError: The mesh is not from this space.
    """
    uv = carry_pattern(space, mesh, design)
    before, after = signed_areas(mesh.uv, mesh.faces_uv), signed_areas(uv, mesh.faces_uv)
    if (before * after <= 0).any() or abs(np.abs(after).mean() / mesh.target_area - 1) > MOST_DENSITY_CHANGE:
        return None
    quality = measure_quality(uv, mesh.faces_uv)
    if quality.max_distortion > max_distortion:
        return None
    return replace(mesh, uv=uv, design=design, quality=quality)
