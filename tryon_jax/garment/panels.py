"""Panels as flat meshes and as pictures, before they are sewn."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from tryon_jax.files.atomic import atomic_path, write_text
from tryon_jax.garment.design import Design, DesignSpace
from tryon_jax.garment.mesh import GarmentMesh, SewnMesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GAP = 0.05
"""Space between panels that are laid out side by side, metres."""


def lay_out(mesh: SewnMesh) -> Float[np.ndarray, "U 2"]:
    """UV of a mesh with its panels side by side instead of over one another, metres; the lowest corner is at (0, 0)."""
    uv = mesh.uv.copy()
    left = 0.0
    for k in range(len(mesh.panel_names)):
        here = mesh.uv_panels == k
        low, high = uv[here].min(axis=0), uv[here].max(axis=0)
        uv[here] += np.array([left - low[0], 0.0])
        left += high[0] - low[0] + GAP
    uv[:, 1] -= uv[:, 1].min()
    return uv


def write_panels_obj(path: str | Path, mesh: SewnMesh) -> None:
    """Write the flat panels as an OBJ: one object each, laid out side by side in the plane z = 0, metres.

    Texture coordinates are those positions over the width of the layout, so that they lie in 0 to 1 and keep the
    panels' proportions. Faces of all panels look to +z.
    """
    uv = lay_out(mesh)
    lines = ["# flat panels, metres"]
    lines += [f"v {u:.6f} {v:.6f} 0" for u, v in uv.tolist()]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in (uv / uv.max()).tolist()]
    for k, name in enumerate(mesh.panel_names):
        lines.append(f"o {name}")
        faces = mesh.faces_uv[mesh.panels == k] + 1
        if mesh.panel_sides[k] == "back":
            faces = faces[:, [0, 2, 1]]
        lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in faces.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def draw_panels(axes: "Axes", space: DesignSpace, design: Design, color: str = "#2b4a6b") -> None:
    """Draw a design's panels over one another, as on a pattern sheet: outlines filled, the first in front.

    Args:
        axes: Where to draw.
        space: The design's space.
        design: The design.
        color: Of the outlines; the fill is a paler one.
    """
    drawn = space.draw(design)
    for panel in reversed(space.layout.panels):
        outline = space.layout.panel_outline(panel, drawn)
        axes.fill(*outline.T, facecolor=color, alpha=0.16, edgecolor="none")
        axes.plot(*np.concatenate([outline, outline[:1]]).T, color=color, linewidth=1.0)
    axes.set_aspect("equal")
    axes.set_axis_off()


def draw_triangles(
    axes: "Axes", mesh: SewnMesh, panel: int = 0, color: str = "#2b4a6b", linewidth: float = 0.35
) -> None:
    """Draw one panel's triangles in UV.

    Args:
        axes: Where to draw.
        mesh: The garment.
        panel: Number of the panel.
        color: Of the lines.
        linewidth: Points.
    """
    axes.triplot(*mesh.uv.T, mesh.faces_uv[mesh.panels == panel], color=color, linewidth=linewidth)
    axes.set_aspect("equal")
    axes.set_axis_off()


def picture_pattern(path: str | Path, space: DesignSpace, garment: GarmentMesh) -> None:
    """Write a picture of a design: its panels, and each panel's triangles.

    Args:
        path: Picture to write.
        space: The design's space.
        garment: The design's mesh.

    Raises:
        ImportError: where matplotlib (the extra `pictures`) is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures of patterns need matplotlib: pip install 'tryon_jax[pictures]'") from error
    names = garment.panel_names
    width = float(np.ptp(garment.uv[:, 0])) + 0.1
    height = float(np.ptp(garment.uv[:, 1])) + 0.25
    figure = Figure(figsize=(6 * width * (1 + len(names)), 6 * height), dpi=110, layout="constrained")
    axes = figure.subplots(1, 1 + len(names), squeeze=False)[0]
    draw_panels(axes[0], space, garment.design)
    axes[0].set_title("panels")
    for k, name in enumerate(names):
        draw_triangles(axes[1 + k], garment, k)
        axes[1 + k].set_title(f"{name}, {int((garment.panels == k).sum())} triangles")
    quality = garment.quality
    figure.suptitle(
        f"{garment.design}\n{garment.num_vertices} vertices, mean area {1e4 * quality.mean_area:.2f} cm², smallest "
        f"angle {quality.min_angle:.0f}°"
    )
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
