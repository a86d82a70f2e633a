"""Where the vertices of a sewn mesh lie on the flat pattern."""

import numpy as np
from jaxtyping import Float

from tryon_jax.garment.mesh import SewnMesh

_SIDES = {"front": 1.0, "back": -1.0}


def pattern_places(mesh: SewnMesh) -> Float[np.ndarray, "V 3"]:
    """Flat coordinates u and v of each vertex, metres, and its side: 1 on the front, −1 on the back.

    A vertex on a seam has the mean of its places: the side is 0 between front and back.

    Args:
        mesh: The sewn mesh.
    """
    sides = np.array([_SIDES[side] for side in mesh.panel_sides])[mesh.uv_panels]
    places = np.column_stack([mesh.uv, sides])
    total = np.zeros((mesh.num_vertices, 3))
    np.add.at(total, mesh.uv_vertex, places)
    return total / np.bincount(mesh.uv_vertex, minlength=mesh.num_vertices)[:, None]
