"""The result of sewing: one welded surface with UV coordinates on both sides of each seam."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.garment.design import Design
from tryon_jax.mesh.quality import MeshQuality


@dataclass(frozen=True, eq=False)
class SewnMesh:
    """A sewn garment as a surface without positions in space (host side, NumPy).

    Vertices of the two sides of a seam are one vertex; `uv` keeps both sides, so that `faces_uv` has the faces of
    `faces` with other indices. Front panels are counter-clockwise in UV; both panels are seen from the front, so
    back panels are clockwise in UV and every face is counter-clockwise seen from outside the garment.
    """

    faces: Int[np.ndarray, "F 3"]
    """Triangles, indices of vertices, counter-clockwise from outside."""
    uv: Float[np.ndarray, "U 2"]
    """Flat pattern coordinates, metres: u to the body's left, v up."""
    faces_uv: Int[np.ndarray, "F 3"]
    """Triangles, indices into `uv`."""
    panels: Int[np.ndarray, " F"]
    """Panel of each face, an index into `panel_names`."""
    uv_panels: Int[np.ndarray, " U"]
    """Panel of each uv."""
    panel_names: tuple[str, ...]
    """Names of the panels in the layout's order ("front", "back")."""
    panel_sides: tuple[str, ...]
    """Side of the body that each panel covers: "front" or "back"."""
    loops: Mapping[str, Int[np.ndarray, " _"]]
    """Open borders by name (neck, hem, cuff_left, cuff_right): vertices in order round the loop."""
    seams: Mapping[str, Int[np.ndarray, " _"]]
    """Sewn seams by name: vertices from end to end, ends included."""
    seam_uv: Mapping[str, Int[np.ndarray, "_ 2"]]
    """The two uv indices at each vertex of a seam, in the same order."""
    outlines: tuple[Int[np.ndarray, " _"], ...]
    """For each panel its outline as indices into `uv`, counter-clockwise in UV."""
    vertex_uv: Int[np.ndarray, " V"]
    """One uv of each vertex."""
    uv_vertex: Int[np.ndarray, " U"]
    """The vertex of each uv."""
    design: Design
    """The design it was cut by."""

    @property
    def num_vertices(self) -> int:
        """Number of vertices V."""
        return len(self.vertex_uv)


@dataclass(frozen=True, eq=False)
class GarmentMesh(SewnMesh):
    """A garment at its working resolution, tied to the template: the result of `remesh`."""

    template_vertices: Int[np.ndarray, "V 3"]
    """Vertices of the template triangle in which each vertex lies."""
    template_weights: Float[np.ndarray, "V 3"]
    """Barycentric weights in that triangle: not negative, rows sum to 1."""
    target_area: float
    """Mean triangle area that was asked for, square metres."""
    quality: MeshQuality
    """Measured in UV, over all panels."""
    seed: int
    """Seed of the topology."""


def place_on_template(garment: GarmentMesh, template_positions: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "V 3"]:
    """Positions of a garment whose template is draped: M̄ = W T̄ (section "Mesh Topology Optimization")."""
    return (garment.template_weights[:, :, None] * template_positions[garment.template_vertices]).sum(axis=1)
