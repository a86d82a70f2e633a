"""The template: a small sewn mesh with the same connectivity for every design, whose UV follow the design.

The reference is the triangulated mean design; it is moved to the outlines of other designs (`morph`).
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.garment.curves import polygon_area
from tryon_jax.garment.design import Design, DesignSpace
from tryon_jax.garment.layout import Layout
from tryon_jax.garment.locate import tie_panel
from tryon_jax.garment.mesh import SewnMesh
from tryon_jax.garment.morph import morph
from tryon_jax.garment.sewing import SampledOutline, count_outline_vertices, edge_counts, sample_outline, sew
from tryon_jax.garment.triangulate import edge_length, interior_count, triangulate

TEMPLATE_VERTICES = 403
"""Vertices of the template (section "Dataset and Implementation Details")."""

REFERENCE_SEED = 5
"""Of the seeds 0 to 7 the one whose template has the fewest thin triangles over the kimono's space: at 64 random
designs and the 8 corners none is inverted and at most 0.4 % have an angle under 10 degrees."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A triangulated reference design, from which every other design's template is made."""

    values: Mapping[str, float]
    """Values of all the layout's parameters."""
    counts: Mapping[str, int]
    """Segments on each edge."""
    points: tuple[Float[np.ndarray, "_ 2"], ...]
    """Points of each panel, outline first."""
    faces: tuple[Int[np.ndarray, "_ 3"], ...]
    """Counter-clockwise triangles of each panel."""


def make_reference(layout: Layout, num_vertices: int, seed: int = REFERENCE_SEED) -> Reference:
    """Triangulate the layout's mean design so that the sewn mesh has exactly `num_vertices` vertices.

    Args:
        layout: The layout.
        num_vertices: Vertices of the sewn mesh.
        seed: Of the triangulation.

    Raises:
        ValueError: where so few vertices cannot follow the layout's outlines.
    """
    values = {p.name: p.mean for p in layout.parameters}
    outlines, counts, inner = _share_vertices(layout, layout.draw(values), num_vertices)
    rng = np.random.default_rng(seed)
    made = [triangulate(o.points, n, rng, iterations=60, refresh=4) for o, n in zip(outlines, inner, strict=True)]
    return Reference(values, counts, tuple(p for p, _ in made), tuple(f for _, f in made))


def _share_vertices(
    layout: Layout, drawn: Mapping[str, np.ndarray], num_vertices: int
) -> tuple[list[SampledOutline], dict[str, int], list[int]]:
    """Outline samples, and points inside each panel, that add up to `num_vertices` after sewing."""
    area = sum(polygon_area(layout.panel_outline(panel, drawn)) for panel in layout.panels)
    spacing = edge_length(area / (2 * num_vertices))
    for _ in range(40):
        counts = edge_counts(layout, drawn, spacing)
        outlines = [sample_outline(panel, drawn, counts) for panel in layout.panels]
        inner = [interior_count(o.points, np.sqrt(3) / 4 * spacing**2) for o in outlines]
        missing = num_vertices - count_outline_vertices(layout, outlines) - sum(inner)
        if abs(missing) <= max(2, 0.02 * num_vertices):
            # The rest is shared out evenly: the number of samples of an outline changes by whole edges and rarely fits.
            for k in range(abs(missing)):
                inner[k % len(inner)] += int(np.sign(missing))
            if min(inner) >= 0:
                return outlines, counts, inner
        spacing *= float(np.sqrt((num_vertices - missing) / num_vertices))
    raise ValueError(f"{layout.source}: no template of {num_vertices} vertices follows its outlines")


def _reference_file(layout: Layout, num_vertices: int) -> Path | None:
    file = resources.files("tryon_jax") / "data" / "layouts" / f"{layout.name}_{num_vertices}.npz"
    path = Path(str(file))
    return path if layout.builtin and path.is_file() else None


def save_reference(reference: Reference, path: str | Path) -> None:
    """Write a reference as an npz file (see `load_reference`)."""
    arrays: dict[str, np.ndarray] = {
        "parameters": np.array(list(reference.values)),
        "values": np.array(list(reference.values.values())),
        "edges": np.array(list(reference.counts)),
        "counts": np.array(list(reference.counts.values()), np.int32),
    }
    for k, (points, faces) in enumerate(zip(reference.points, reference.faces, strict=True)):
        arrays[f"points_{k}"] = points
        arrays[f"faces_{k}"] = faces.astype(np.int16 if len(points) < 2**15 else np.int32)
    np.savez_compressed(path, allow_pickle=False, **arrays)


@functools.cache
def load_reference(layout: Layout, num_vertices: int = TEMPLATE_VERTICES) -> Reference:
    """The reference of a layout: read from the library's data where it is kept there, otherwise made.

    Trained networks depend on the template's connectivity, so that of the built-in layout is stored and not made
    again by whatever version of Qhull is installed.
    """
    file = _reference_file(layout, num_vertices)
    if file is None:
        return make_reference(layout, num_vertices)
    with np.load(file, allow_pickle=False) as data:
        values = {str(n): float(v) for n, v in zip(data["parameters"], data["values"], strict=True)}
        counts = {str(n): int(v) for n, v in zip(data["edges"], data["counts"], strict=True)}
        panels = range(len(layout.panels))
        return Reference(
            values,
            counts,
            tuple(data[f"points_{k}"] for k in panels),
            tuple(data[f"faces_{k}"].astype(np.int64) for k in panels),
        )


@dataclass(frozen=True, eq=False)
class TriangulatedPattern:
    """A sewn design together with its panels before sewing."""

    mesh: SewnMesh
    outlines: tuple[SampledOutline, ...]
    """Samples on the outline of each panel."""
    points: tuple[Float[np.ndarray, "_ 2"], ...]
    """Points of each panel, outline first."""
    faces: tuple[Int[np.ndarray, "_ 3"], ...]
    """Counter-clockwise triangles of each panel."""


def sew_pattern(
    layout: Layout,
    design: Design,
    outlines: Sequence[SampledOutline],
    points: Sequence[Float[np.ndarray, "_ 2"]],
    faces: Sequence[Int[np.ndarray, "_ 3"]],
) -> TriangulatedPattern:
    """Sew panels and keep them; see `sew`.

    Args:
        layout: The layout.
        design: The design.
        outlines: Samples of each panel's outline.
        points: Points of each panel, metres; the outline's first.
        faces: Triangles of each panel.
    """
    return TriangulatedPattern(
        sew(layout, design, outlines, points, faces), tuple(outlines), tuple(points), tuple(faces)
    )


def morph_reference(space: DesignSpace, design: Design, num_vertices: int = TEMPLATE_VERTICES) -> TriangulatedPattern:
    """Move the layout's reference to the outlines of a design.

    Args:
        space: The design's space.
        design: The design.
        num_vertices: Vertices of the reference.

    Returns:
        The same triangles on the design's panels.
    """
    layout = space.layout
    reference = load_reference(layout, num_vertices)
    goal = space.layout_values(design)

    @functools.cache
    def drawn_at(t: float) -> dict[str, np.ndarray]:
        return layout.draw({n: (1 - t) * start + t * goal[n] for n, start in reference.values.items()})

    points = []
    for k, panel in enumerate(layout.panels):

        def outline_at(t: float, panel=panel) -> np.ndarray:
            return sample_outline(panel, drawn_at(t), reference.counts).points

        points.append(morph(reference.points[k], reference.faces[k], outline_at))
    outlines = tuple(sample_outline(panel, drawn_at(1.0), reference.counts) for panel in layout.panels)
    # Of the sewn mesh only the pattern's coordinates depend on the design.
    mesh = replace(_sewn_reference(layout, num_vertices), uv=np.concatenate(points), design=design)
    return TriangulatedPattern(mesh, outlines, tuple(points), reference.faces)


@functools.cache
def _sewn_reference(layout: Layout, num_vertices: int) -> SewnMesh:
    reference = load_reference(layout, num_vertices)
    drawn = layout.draw(reference.values)
    outlines = [sample_outline(panel, drawn, reference.counts) for panel in layout.panels]
    mean = Design(tuple(reference.values), np.array(list(reference.values.values())), "reference")
    return sew(layout, mean, outlines, reference.points, reference.faces)


def build_template(space: DesignSpace, design: Design, num_vertices: int = TEMPLATE_VERTICES) -> SewnMesh:
    """The template of a design: connectivity fixed by the layout, UV positions by the design.

    Args:
        space: the design space.
        design: any design in it.
        num_vertices: 403 as in the paper; another number has its own reference, made once per process.

    Returns:
        a sewn mesh with exactly `num_vertices` vertices.

    Source: section "Parametric 3D Drape" and "Dataset and Implementation Details" of the paper.
    """
    return morph_reference(space, design, num_vertices).mesh


def tie_patterns(
    pattern: TriangulatedPattern, base: TriangulatedPattern
) -> tuple[Int[np.ndarray, "V 3"], Float[np.ndarray, "V 3"]]:
    """Barycentric map from the vertices of one triangulation of a design (`base`) to those of another.

    Samples on outlines are tied by their fraction of the edge, so that both sides of a seam agree, points inside by
    the triangle of `base` that they lie in; weights are clamped where `base` cuts the corner of a curve.

    Returns:
        vertices of `base` [V, 3] and weights [V, 3] (not negative, rows sum to 1) for every vertex of `pattern`.
    """
    vertices = np.zeros((pattern.mesh.num_vertices, 3), np.int64)
    weights = np.zeros((pattern.mesh.num_vertices, 3))
    own = base_start = 0
    for k, points in enumerate(pattern.points):
        corners, weight = tie_panel(
            points, pattern.outlines[k].edges, base.points[k], base.faces[k], base.outlines[k].edges
        )
        at = pattern.mesh.uv_vertex[own : own + len(points)]
        vertices[at] = base.mesh.uv_vertex[base_start + corners]
        weights[at] = weight
        own += len(points)
        base_start += len(base.points[k])
    return vertices, weights
