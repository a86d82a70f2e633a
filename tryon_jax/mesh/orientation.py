"""Which way the faces of a mesh look: turned to agree with each other, and outwards."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import breadth_first_order, connected_components

from tryon_jax.mesh.topology import directed_edges, edge_keys


def find_flips(faces: Int[np.ndarray, "F 3"], count: int, name: str) -> Bool[np.ndarray, " F"]:
    """Which faces to turn so that neighbours agree, the fewer in each piece.

    Args:
        faces: Triangles, no edge with more than two.
        count: Vertices.
        name: What messages call the mesh.

    Raises:
        ValueError: a surface with one side only.
    """
    half = directed_edges(faces)
    face_of = np.tile(np.arange(len(faces)), 3)
    keys = edge_keys(half, count)
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    first, second = order[same], order[same + 1]
    disagree = half[first, 0] == half[second, 0]
    a, b = face_of[first], face_of[second]
    total = len(faces)
    graph = sp.coo_matrix((np.ones(len(a)), (a, b)), (total, total)).tocsr()
    graph = graph + graph.T
    # Entries 1 and 2 tell edges that agree from those that do not; two faces never share more than one edge here.
    weight = sp.coo_matrix((1.0 + disagree, (a, b)), (total, total)).tocsr()
    weight = weight.maximum(weight.T)
    flip = np.zeros(total, bool)
    pieces, label = connected_components(graph, directed=False)
    for k in range(pieces):
        root = int(np.argmax(label == k))
        visited, before = breadth_first_order(graph, root, directed=False)
        for face in visited[1:]:
            flip[face] = flip[before[face]] ^ (weight[before[face], face] == 2.0)
        mine = label == k
        if flip[mine].mean() > 0.5:
            flip[mine] = ~flip[mine]
    if (flip[a] ^ flip[b] ^ disagree).any():
        raise ValueError(f"{name} has one side only (like a Möbius strip): its faces cannot be turned to agree")
    return flip


def turn_faces(faces: Int[np.ndarray, "F 3"], flip: Bool[np.ndarray, " F"]) -> Int[np.ndarray, "F 3"]:
    """Triangles with some of them turned over."""
    return np.where(flip[:, None], faces[:, [0, 2, 1]], faces)


def closed_volume(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], loops: list[Int[np.ndarray, " _"]]
) -> float:
    """Signed volume after closing each open loop with a fan to its centre: negative for faces that look inwards.

    Args:
        vertices: Metres.
        faces: Triangles that agree.
        loops: Open borders.
    """

    def volume(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6

    total = volume(vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]])
    for loop in loops:
        ring = vertices[loop]
        centre = np.broadcast_to(ring.mean(axis=0), ring.shape)
        total += volume(np.roll(ring, -1, axis=0), ring, centre)
    return total
