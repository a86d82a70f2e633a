"""Smooth necklines, cuffs and hems for pictures: the mesh cut finer, its borders as curves."""

from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float, Int

from tryon_jax.mesh.topology import border_edges


def smooth_border(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    values: Float[np.ndarray, "V k"],
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"], Float[np.ndarray, "W k"]]:
    """Each triangle cut in four, and open borders moved to the cubic B-spline of their vertices.

    Inside nothing moves; a border vertex moves by an eighth of the second difference along the border (Loop's rule).

    Args:
        vertices: Metres.
        faces: Triangles.
        values: What else is known at each vertex, such as its colour.

    Returns:
        Vertices, faces and values of the finer mesh.
    """
    edges = border_edges(faces, len(vertices))
    moved = np.array(vertices, np.float64)
    # Only where a border is a line: at a corner of several borders nothing says which two belong together.
    count = np.bincount(edges.ravel(), minlength=len(vertices))
    total = np.zeros_like(moved)
    np.add.at(total, edges[:, 0], moved[edges[:, 1]])
    np.add.at(total, edges[:, 1], moved[edges[:, 0]])
    on_line = count == 2
    cut_all: Any = trimesh.remesh.subdivide(moved, faces, vertex_attributes={"values": np.asarray(values, np.float64)})
    fine, cut, mixed = cut_all
    # The first vertices of the finer mesh are the old ones; the middles of edges stay where they are.
    fine = np.array(fine)
    fine[: len(vertices)][on_line] = 0.75 * moved[on_line] + 0.125 * total[on_line]
    return fine, np.asarray(cut), mixed["values"]
