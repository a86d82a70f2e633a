"""Edges that are stretched too far, pulled together: what a network gets wrong at a few vertices, as in an armpit.

Position-based dynamics (Müller et al. 2007) with the edges as inequality constraints: round by round the ends of each
edge that is too long move towards each other, and a vertex moves by the mean over its edges.
"""

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.mesh.quality import edge_lengths
from tryon_jax.mesh.topology import directed_edges, edge_keys

ROUNDS = 100


def rest_edges(
    faces: Int[np.ndarray, "F 3"], lengths: Float[np.ndarray, "F 3"], num_vertices: int
) -> tuple[Int[np.ndarray, "E 2"], Float[np.ndarray, " E"]]:
    """Edges and the rest length of each, metres; the longer one where two faces give it different ones.

    Args:
        faces: Triangles.
        lengths: Of the edges 0→1, 1→2 and 2→0 of each face, metres.
        num_vertices: Of the mesh.
    """
    keys = edge_keys(directed_edges(faces), num_vertices)
    # `directed_edges` lists the first edges of all faces, then the second ones, then the third ones.
    unique, place = np.unique(keys, return_inverse=True)
    longest = np.zeros(len(unique))
    np.maximum.at(longest, place, lengths.T.reshape(-1))
    return np.stack(np.divmod(unique, num_vertices), axis=1), longest


def limit_stretch(
    vertices: Float[np.ndarray, "V 3"],
    edges: Int[np.ndarray, "E 2"],
    rest: Float[np.ndarray, " E"],
    most: float,
    rounds: int = ROUNDS,
) -> Float[np.ndarray, "V 3"]:
    """The mesh with no edge longer than `most` times its rest length, or nearly so after `rounds`; metres.

    Vertices without such an edge stay where they are, and a mesh without any is returned as it is.

    Args:
        vertices: The mesh, metres.
        edges: From `rest_edges`.
        rest: Rest length of each, metres.
        most: Length over rest length.
        rounds: At most.
    """
    a, b = edges.T
    allowed, points = most * rest, np.asarray(vertices, np.float64)
    if not _too_long(points, a, b, allowed).any():
        return vertices
    count = len(points)
    for _ in range(rounds):
        apart = points[b] - points[a]
        length = np.sqrt((apart * apart).sum(axis=1))
        long = length > allowed
        if not long.any():
            break
        ends = np.concatenate([a[long], b[long]])
        pull = 0.5 * (1.0 - allowed[long] / length[long])[:, None] * apart[long]
        moves = np.concatenate([pull, -pull])
        shared = np.maximum(np.bincount(ends, minlength=count), 1)
        total = np.stack([np.bincount(ends, moves[:, axis], count) for axis in range(3)], axis=1)
        points = points + total / shared[:, None]
    return points.astype(vertices.dtype)


def _too_long(points: np.ndarray, a: np.ndarray, b: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    apart = points[b] - points[a]
    return (apart * apart).sum(axis=1) > allowed * allowed


def rest_lengths(
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "U 2"],
    faces_uv: Int[np.ndarray, "F 3"],
    mean: Float[np.ndarray, "V 3"],
) -> Float[np.ndarray, "F 3"]:
    """Lengths that edges of a drape are measured against, metres: the longer of the pattern and the mean drape.

    Args:
        faces: Triangles.
        uv: The pattern, metres.
        faces_uv: Entry of `uv` of every face corner.
        mean: The garment on the mean body, metres.
    """
    return np.maximum(edge_lengths(uv, faces_uv), edge_lengths(mean, faces))
