"""φ: from a design to a garment mesh of even triangles, tied to the template (section "Mesh Topology Optimization")."""

from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np

from tryon_jax.checks import check_finite, check_range
from tryon_jax.garment.curves import polygon_area
from tryon_jax.garment.design import Design, DesignSpace
from tryon_jax.garment.locate import locate, on_edges
from tryon_jax.garment.mesh import GarmentMesh, SewnMesh
from tryon_jax.garment.sewing import SampledOutline, edge_counts, sample_outline, sew
from tryon_jax.garment.template import build_template, load_reference
from tryon_jax.garment.triangulate import edge_length, interior_count, triangulate
from tryon_jax.mesh.quality import distortion, measure_quality

TARGET_AREA = 1.78e-4
"""Mean triangle area of the training set, square metres (edges of about 2 cm)."""

MAX_DISTORTION = 2.5
"""Default bound on the distortion of any triangle."""

SMALLEST_SHARE, LARGEST_SHARE = 2e-6, 0.004
"""Range of a triangle's area as a share of the pattern's: half a million down to 250 triangles."""


def remesh(
    space: DesignSpace,
    design: Design,
    target_area: float = TARGET_AREA,
    max_distortion: float = MAX_DISTORTION,
    seed: int = 0,
    template: SewnMesh | None = None,
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
        max_distortion: T_dist, at least 1.6.
        seed: another seed gives another topology with the same number of triangles, hence the same mean area.
        template: the design's template, where it has been built already.

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
    check_range("max_distortion", max_distortion, 1.6, 1e3)
    counts = edge_counts(layout, drawn, edge_length(area))
    outlines = [sample_outline(panel, drawn, counts) for panel in layout.panels]
    points, faces = [], []
    rng = np.random.default_rng(seed)
    for panel, outline in zip(layout.panels, outlines, strict=True):
        made = _within(outline, interior_count(outline.points, area), max_distortion, rng, f"{panel.name} of {design}")
        points.append(made[0])
        faces.append(made[1])
    sewn = sew(layout, design, outlines, points, faces)
    vertices, weights = _tie(space, sewn, outlines, template or build_template(space, design))
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
        points, faces = triangulate(outline.points, count, rng, iterations=40 * (attempt + 1), refresh=4)
        worst = min(worst, float(distortion(points, faces).max()))
        if worst <= max_distortion:
            return points, faces
    raise ValueError(f"max_distortion = {max_distortion:g} was not reached for panel {what}: best {worst:.3f}")


def _tie(
    space: DesignSpace, sewn: SewnMesh, outlines: Sequence[SampledOutline], template: SewnMesh
) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric map W from the template's vertices to the garment's.

    Samples on outlines are tied by their fraction of the edge, so that both sides of a seam agree, points inside by
    the triangle of the template that they lie in; weights are clamped where the template cuts a curve's corner.
    """
    reference = load_reference(space.layout, template.num_vertices)
    drawn = space.draw(template.design)
    vertices = np.zeros((sewn.num_vertices, 3), np.int64)
    weights = np.zeros((sewn.num_vertices, 3))
    for k, panel in enumerate(space.layout.panels):
        coarse = np.flatnonzero(template.uv_panels == k)
        fine = np.flatnonzero(sewn.uv_panels == k)
        coarse_faces = template.faces_uv[template.panels == k] - coarse[0]
        inner = fine[len(outlines[k].points) :]
        face, weight = locate(sewn.uv[inner], template.uv[coarse], coarse_faces)
        vertices[sewn.uv_vertex[inner]] = template.uv_vertex[coarse[coarse_faces[face]]]
        weights[sewn.uv_vertex[inner]] = weight
        knots: Mapping[str, np.ndarray] = sample_outline(panel, drawn, reference.counts).edges
        samples, ends, weight = on_edges(outlines[k].edges, knots)
        vertices[sewn.uv_vertex[fine[samples]]] = template.uv_vertex[coarse[ends]]
        weights[sewn.uv_vertex[fine[samples]]] = weight
    return vertices, weights
