"""How much a drape stretches its pattern: strain of edges and of areas against the flat panels."""

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.mesh.quality import areas, edge_lengths


def edge_strain(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    rest: Float[np.ndarray, "U D"],
    rest_faces: Int[np.ndarray, "F 3"],
) -> Float[np.ndarray, "F 3"]:
    """Length over rest length minus 1 of the edges 0→1, 1→2 and 2→0 of each face.

    Args:
        vertices: The drape, metres.
        faces: Its triangles.
        rest: Rest positions: UV in metres, or another drape.
        rest_faces: The same triangles as indices into `rest` (`faces_uv` for UV).
    """
    return edge_lengths(vertices, faces) / edge_lengths(rest, rest_faces) - 1.0


def area_strain(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    rest: Float[np.ndarray, "U D"],
    rest_faces: Int[np.ndarray, "F 3"],
) -> Float[np.ndarray, " F"]:
    """Area over rest area minus 1 of each face; arguments as for `edge_strain`.

    Args:
        vertices: The drape, metres.
        faces: Its triangles.
        rest: Rest positions: UV in metres, or another drape.
        rest_faces: The same triangles as indices into `rest` (`faces_uv` for UV).
    """
    return areas(vertices, faces) / areas(rest, rest_faces) - 1.0
