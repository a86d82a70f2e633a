"""The dense mesh of a design: first simulations run on it, and are then downsampled to the template.

Each dense vertex keeps its place in a template triangle for every design, so that the two stay aligned. Outlines follow
the design's own curves.
"""

import functools
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.linalg import SuperLU, splu

from tryon_jax.garment.design import Design, DesignSpace
from tryon_jax.garment.layout import Layout
from tryon_jax.garment.locate import tie_panel
from tryon_jax.garment.mesh import SewnMesh
from tryon_jax.garment.morph import mean_value_laplacian, spread, untangle
from tryon_jax.garment.sewing import count_outline_vertices, sample_outline
from tryon_jax.garment.template import load_reference, morph_reference, sew_pattern, tie_patterns
from tryon_jax.garment.triangulate import triangulate

DENSE_VERTICES = 17_246
"""Vertices of the mesh for first simulations and for the fully connected baseline (paper, "Dataset and
Implementation Details")."""


@dataclass(frozen=True, eq=False)
class DenseTemplate:
    """A dense mesh of a design in the template's parametrisation, and the map from its drapes to the template's."""

    mesh: SewnMesh
    """Connectivity is the same for every design."""
    template: SewnMesh
    """The design's template."""
    vertices: Int[np.ndarray, "T 3"]
    """For each template vertex the corners of the dense triangle in which it lies."""
    weights: Float[np.ndarray, "T 3"]
    """Barycentric weights in that triangle."""

    def downsample(self, positions: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "T 3"]:
        """Template positions T̄ of a drape of the dense mesh: each at the same place of the fabric."""
        return (self.weights[:, :, None] * positions[self.vertices]).sum(axis=1)


@dataclass(frozen=True, eq=False)
class _DensePanel:
    points: np.ndarray
    faces: np.ndarray
    corners: np.ndarray
    weights: np.ndarray
    inner: SuperLU
    border: sp.csr_matrix


@functools.cache
def _dense_reference(layout: Layout, num_vertices: int) -> tuple[dict[str, int], tuple[_DensePanel, ...]]:
    """The dense triangulation of the template's reference design, tied to the template."""
    template = load_reference(layout)
    drawn = layout.draw(template.values)
    finer = max(1, round(np.sqrt(num_vertices / sum(len(p) for p in template.points))))
    counts = {edge: finer * n for edge, n in template.counts.items()}
    outlines = [sample_outline(panel, drawn, counts) for panel in layout.panels]
    inner = num_vertices - count_outline_vertices(layout, outlines)
    if inner < 0:
        raise ValueError(f"a dense template of {num_vertices} vertices is too small: its outlines alone have more")
    shares = np.array([len(p) for p in template.points], float)
    split = np.floor(inner * shares / shares.sum()).astype(int)
    split[0] += inner - split.sum()
    rng = np.random.default_rng(0)
    panels = []
    for k, panel in enumerate(layout.panels):
        points, faces = triangulate(outlines[k].points, int(split[k]), rng, iterations=40, refresh=8)
        base = sample_outline(panel, drawn, template.counts).edges
        corners, weights = tie_panel(points, outlines[k].edges, template.points[k], template.faces[k], base)
        fixed = len(outlines[k].points)
        laplacian = mean_value_laplacian(points, faces)
        factor = splu(laplacian[fixed:, fixed:].tocsc())
        panels.append(_DensePanel(points, faces, corners, weights, factor, laplacian[fixed:, :fixed]))
    return counts, tuple(panels)


def dense_template(space: DesignSpace, design: Design, num_vertices: int = DENSE_VERTICES) -> DenseTemplate:
    """The dense mesh for a design's first simulation, consistently downsampled to the template.

    Its outlines are sampled a whole number of times more finely than the template's, so that both share their samples
    on every seam and loop; a template vertex inside a panel takes the dense triangle in which it lies.

    Args:
        space: the design space.
        design: any design in it.
        num_vertices: 17,246 as in the paper. The first call in a process triangulates the mean design, a few seconds.

    Raises:
        ValueError: for fewer vertices than the finer outlines have.

    Source: section "Dataset and Implementation Details" of the paper.
    """
    layout = space.layout
    template = morph_reference(space, design)
    counts, panels = _dense_reference(layout, num_vertices)
    drawn = space.draw(design)
    outlines = [sample_outline(panel, drawn, counts) for panel in layout.panels]
    points = []
    for outline, panel, base in zip(outlines, panels, template.points, strict=True):
        fixed = len(outline.points)
        here = (panel.weights[:, :, None] * base[panel.corners]).sum(axis=1)
        # The template cuts the corners of curves: the gap to the true outline fades out harmonically inside.
        gap = outline.points - here[:fixed]
        here[:fixed] += gap
        here[fixed:] += panel.inner.solve(-(panel.border @ gap))
        points.append(spread(untangle(here, panel.faces, fixed), panel.faces, fixed, iterations=6))
    dense = sew_pattern(layout, design, outlines, points, [panel.faces for panel in panels])
    vertices, weights = tie_patterns(template, dense)
    return DenseTemplate(dense.mesh, template.mesh, vertices, weights)
