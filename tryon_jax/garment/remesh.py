"""φ: from a design to a garment mesh of even triangles, tied to the template (section "Mesh Topology Optimization")."""

from dataclasses import fields

import numpy as np

from tryon_jax.checks import check_finite, check_range
from tryon_jax.garment.curves import polygon_area
from tryon_jax.garment.design import Design, DesignSpace
from tryon_jax.garment.mesh import GarmentMesh, SewnMesh
from tryon_jax.garment.sewing import SampledOutline, edge_counts, sample_outline
from tryon_jax.garment.template import morph_reference, sew_pattern, tie_patterns
from tryon_jax.garment.triangulate import edge_length, interior_count, triangulate
from tryon_jax.mesh.quality import distortion, measure_quality

TARGET_AREA = 1.78e-4
"""Mean triangle area of the training set, square metres (edges of about 2 cm)."""

MAX_DISTORTION = 2.5
"""Default bound on the distortion of any triangle."""

SMALLEST_SHARE, LARGEST_SHARE = 2e-6, 0.01
"""Range of a triangle's area as a share of the pattern's: half a million down to 100 triangles."""


def remesh(
    space: DesignSpace,
    design: Design,
    target_area: float = TARGET_AREA,
    max_distortion: float = MAX_DISTORTION,
    seed: int = 0,
) -> GarmentMesh:
    """Triangulate a design's panels anew, sew them, and tie every vertex to the template.

    T_area is measured as the mean area of all triangles in UV: the number of points inside each panel is chosen so
    that it is met to within one triangle. T_dist is measured as `tryon_jax.mesh.quality.distortion` in UV (longest
    edge over 2 √3 times the inradius, 1 for an equilateral triangle); `max_distortion` bounds its maximum over the
    mesh, and its mean is reported beside it in `GarmentMesh.quality`.

    Args:
        space: the design space.
        design: a design in it.
        target_area: T_area, square metres. At 1.78e-4 the training designs have 1.4 to 3.6 thousand vertices.
        max_distortion: T_dist, at least 1.2.
        seed: another seed gives another topology with the same number of triangles, hence the same mean area.

    Returns:
        the garment mesh; its positions are `place_on_template(garment, T̄)`, linear in the template's positions.

    Raises:
        ValueError: for an area or a bound out of range, or where no triangulation within the bound was found.
    """
    layout = space.layout
    drawn = space.draw(design)
    total = sum(polygon_area(layout.panel_outline(panel, drawn)) for panel in layout.panels)
    area = float(check_finite("target_area", target_area))
    check_range("target_area", area, SMALLEST_SHARE * total, LARGEST_SHARE * total, "m^2")
    check_range("max_distortion", max_distortion, 1.2, 1e3)
    check_range("seed", seed, 0, 2**63)
    counts = edge_counts(layout, drawn, edge_length(area))
    outlines = [sample_outline(panel, drawn, counts) for panel in layout.panels]
    points, faces = [], []
    rng = np.random.default_rng(seed)
    for panel, outline in zip(layout.panels, outlines, strict=True):
        made = _within(outline, interior_count(outline.points, area), max_distortion, rng, f"{panel.name} of {design}")
        points.append(made[0])
        faces.append(made[1])
    pattern = sew_pattern(layout, design, outlines, points, faces)
    sewn = pattern.mesh
    vertices, weights = tie_patterns(pattern, morph_reference(space, design))
    return GarmentMesh(
        **{f.name: getattr(sewn, f.name) for f in fields(SewnMesh)},
        template_vertices=vertices,
        template_weights=weights,
        target_area=area,
        quality=measure_quality(sewn.uv, sewn.faces_uv),
        seed=seed,
    )


def _within(
    outline: SampledOutline, count: int, max_distortion: float, rng: np.random.Generator, what: str
) -> tuple[np.ndarray, np.ndarray]:
    """A triangulation whose worst triangle is within the bound; up to four tries, each relaxed for longer."""
    worst = np.inf
    for attempt in range(4):
        points, faces = triangulate(outline.points, count, rng, iterations=40 * (attempt + 1))
        worst = min(worst, float(distortion(points, faces).max()))
        if worst <= max_distortion:
            return points, faces
    raise ValueError(f"max_distortion = {max_distortion:g} was not reached for panel {what}: best {worst:.3f}")
