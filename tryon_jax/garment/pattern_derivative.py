"""How a garment's pattern moves with its design while its triangles stay the same.

Outline samples follow the design's own curves; points inside follow them by the mean-value weights (Floater 2003) of
the pattern as it is. For small changes: no triangle is mended, and a vertex stays what it was.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.sparse.linalg import splu

from tryon_jax.garment.design import Design, DesignSpace
from tryon_jax.garment.mesh import GarmentMesh
from tryon_jax.garment.morph import mean_value_laplacian
from tryon_jax.garment.sewing import edge_counts, sample_outline
from tryon_jax.garment.triangulate import edge_length

STEP = 1e-3
"""Metres to either side of a parameter: the curves are polylines, whose corners so large a step averages."""


def carry_pattern(space: DesignSpace, mesh: GarmentMesh, design: Design) -> Float[np.ndarray, "U 2"]:
    """The pattern's coordinates with the same triangles at a design near its own, metres; host side.

    Args:
        space: The design space that the mesh was made in.
        mesh: From `remesh`.
        design: Near `mesh.design`: triangles are not kept from turning over.

    Raises:
        ValueError: The mesh is not from this space.
    """
    outline_at, carry = _carrier(space, mesh)
    return mesh.uv + carry(outline_at(design.values) - outline_at(mesh.design.values))


def pattern_derivative(space: DesignSpace, mesh: GarmentMesh) -> Float[np.ndarray, "U 2 P"]:
    """Derivative of the pattern's coordinates by each design parameter, metres per metre; host side.

    One factorisation serves all parameters. Layouts may hold `min`, `max` and `clamp`: at such a corner the derivative
    is the mean of both sides.

    Args:
        space: The design space that the mesh was made in.
        mesh: From `remesh`.

    Raises:
        ValueError: The mesh is not from this space.
    """
    outline_at, carry = _carrier(space, mesh)
    slopes = []
    for parameter in range(len(space.names)):
        step = STEP * np.eye(len(space.names))[parameter]
        ends = [outline_at(mesh.design.values + sign * step) for sign in (-1, 1)]
        slopes.append(carry((ends[1] - ends[0]) / (2 * STEP)))
    return np.stack(slopes, axis=-1)


_Outlines = Float[np.ndarray, "B 2"]
_Points = Float[np.ndarray, "U 2"]


def _carrier(
    space: DesignSpace, mesh: GarmentMesh
) -> tuple[Callable[[np.ndarray], _Outlines], Callable[[_Outlines], _Points]]:
    """Outline samples of all panels by the design's values, and the motion of all points by that of the outlines."""
    foreign = f"the mesh of {mesh.design} was not made in this design space ({', '.join(space.names)})"
    if mesh.design.names != space.names:
        raise ValueError(foreign)
    layout = space.layout
    counts = edge_counts(layout, space.draw(mesh.design), edge_length(mesh.target_area))

    def outline_at(values: np.ndarray) -> _Outlines:
        drawn = space.draw(Design(space.names, values))
        return np.concatenate([sample_outline(panel, drawn, counts).points for panel in layout.panels])

    border = np.concatenate(mesh.outlines)
    own = outline_at(mesh.design.values)
    if own.shape != (len(border), 2) or not np.allclose(own, mesh.uv[border]):
        raise ValueError(foreign)
    inside = np.setdiff1d(np.arange(len(mesh.uv)), border)
    laplacian = mean_value_laplacian(mesh.uv, mesh.faces_uv)
    inner = splu(laplacian[inside][:, inside].tocsc())
    beside = laplacian[inside][:, border]

    def carry(shift: _Outlines) -> _Points:
        moved = np.zeros_like(mesh.uv)
        moved[border] = shift
        moved[inside] = inner.solve(-(beside @ shift))
        return moved

    return outline_at, carry
