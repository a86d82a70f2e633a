"""Connectivity of a triangle mesh: edges, borders, loops, components, manifoldness."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Int
from scipy.sparse.csgraph import connected_components

IntArray = np.ndarray


def directed_edges(faces: Int[IntArray, "F 3"]) -> Int[IntArray, "3*F 2"]:
    """Half-edges (0→1, 1→2, 2→0) of every face, corner-major: half-edge k·F + f belongs to face f."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)


def edge_keys(edges: Int[IntArray, "N 2"], num_vertices: int) -> Int[IntArray, " N"]:
    """One int64 per undirected edge: far faster to sort and compare than rows."""
    low, high = np.minimum(edges[:, 0], edges[:, 1]), np.maximum(edges[:, 0], edges[:, 1])
    return low.astype(np.int64) * num_vertices + high


def unique_keys(keys: Int[IntArray, " N"]) -> Int[IntArray, " U"]:
    """The distinct keys, sorted. `np.unique` hashes integers first, which takes ten times as long."""
    ordered = np.sort(keys)
    return ordered[_first_of_equal(ordered)]


def stable_order(keys: Int[IntArray, " N"]) -> Int[IntArray, " N"]:
    """`np.argsort(keys, kind="stable")` of keys that are not negative, by one fast sort of (key, place) in an int64."""
    shift = max(len(keys) - 1, 0).bit_length()
    if len(keys) and int(keys.max()).bit_length() + shift > 63:
        return np.argsort(keys, kind="stable")
    return np.sort(keys << shift | np.arange(len(keys))) & ((1 << shift) - 1)


def _first_of_equal(ordered: np.ndarray) -> Bool[np.ndarray, " N"]:
    first = np.ones(len(ordered), bool)
    np.not_equal(ordered[1:], ordered[:-1], out=first[1:])
    return first


def unique_edges(faces: Int[IntArray, "F 3"], num_vertices: int) -> tuple[Int[IntArray, "E 2"], Int[IntArray, " E"]]:
    """Undirected edges (smaller index first, sorted) and the number of faces at each."""
    ordered = np.sort(edge_keys(directed_edges(faces), num_vertices))
    first = np.flatnonzero(_first_of_equal(ordered))
    keys = ordered[first]
    return np.stack(np.divmod(keys, num_vertices), axis=1), np.diff(first, append=len(ordered))


def border_edges(faces: Int[IntArray, "F 3"], num_vertices: int) -> Int[IntArray, "B 2"]:
    """Half-edges with a single face, directed as in that face."""
    half = directed_edges(faces)
    keys = edge_keys(half, num_vertices)
    order = stable_order(keys)
    first = np.append(_first_of_equal(keys[order]), True)
    return half[np.sort(order[first[:-1] & first[1:]])]


def border_mask(faces: Int[IntArray, "F 3"], num_vertices: int) -> Bool[IntArray, " V"]:
    """True at vertices on an open border."""
    mask = np.zeros(num_vertices, bool)
    mask[border_edges(faces, num_vertices)] = True
    return mask


def border_loops(faces: Int[IntArray, "F 3"], num_vertices: int) -> list[Int[IntArray, " L"]]:
    """The open loops of a manifold mesh, each as vertices in order along its faces' direction."""
    follow = {int(a): int(b) for a, b in border_edges(faces, num_vertices)}
    loops = []
    while follow:
        start, at = next(iter(follow.items()))
        del follow[start]
        loop = [start]
        while at != start:
            loop.append(at)
            at = follow.pop(at)
        loops.append(np.array(loop))
    return loops


def hinges(faces: Int[IntArray, "F 3"], num_vertices: int) -> tuple[Int[IntArray, "H 4"], Int[IntArray, "H 2"]]:
    """Pairs of faces that share an edge.

    Returns vertices (a, b, c, d), where edge a→b is directed as in the first face, c is opposite in the first face
    and d in the second; and the indices of the two faces.
    """
    half = directed_edges(faces)
    face_of = np.tile(np.arange(len(faces)), 3)
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    keys = edge_keys(half, num_vertices)
    order = stable_order(keys)
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    first, second = order[same], order[same + 1]
    vertices = np.column_stack([half[first], opposite[first], opposite[second]])
    return vertices, np.column_stack([face_of[first], face_of[second]])


def components(faces: Int[IntArray, "F 3"], num_vertices: int) -> tuple[int, Int[IntArray, " V"]]:
    """Number of connected components (vertices without a face count as one each) and each vertex's label."""
    edges, _ = unique_edges(faces, num_vertices)
    ones = np.ones(len(edges))
    graph = sp.coo_matrix((ones, (edges[:, 0], edges[:, 1])), (num_vertices, num_vertices))
    count, label = connected_components(graph, directed=False)
    return int(count), label


@dataclass(frozen=True)
class TopologyReport:
    """Counts that say whether a mesh is a clean surface; see `inspect_topology`."""

    num_vertices: int
    num_faces: int
    euler: int
    """Euler characteristic of the vertices in use: V − E + F."""
    loops: int
    """Open border loops."""
    components: int
    """Connected components among the vertices in use."""
    non_manifold_edges: int
    """Edges with more than two faces."""
    non_manifold_vertices: int
    """Surplus of face fans: a vertex with two separate fans counts one."""
    unused_vertices: int
    consistently_oriented: bool
    """No half-edge occurs twice."""

    @property
    def is_manifold(self) -> bool:
        """True for an oriented manifold (with or without borders) that uses every vertex."""
        defects = self.non_manifold_edges + self.non_manifold_vertices + self.unused_vertices
        return defects == 0 and self.consistently_oriented


def inspect_topology(faces: Int[IntArray, "F 3"], num_vertices: int) -> TopologyReport:
    """Count everything that can be wrong with the connectivity of a triangle mesh."""
    edges, counts = unique_edges(faces, num_vertices)
    half = directed_edges(faces)
    half_keys = half[:, 0] * num_vertices + half[:, 1]
    used = np.flatnonzero(np.bincount(faces.ravel(), minlength=num_vertices))
    _, label = components(faces, num_vertices)
    border = edges[counts == 1]
    graph = sp.coo_matrix((np.ones(len(border)), (border[:, 0], border[:, 1])), (num_vertices, num_vertices))
    border_label = connected_components(graph, directed=False)[1]
    return TopologyReport(
        num_vertices=num_vertices,
        num_faces=len(faces),
        euler=len(used) - len(edges) + len(faces),
        loops=len(unique_keys(border_label[border.ravel()])),
        components=len(unique_keys(label[used])),
        non_manifold_edges=int((counts > 2).sum()),
        non_manifold_vertices=_count_fans(faces, num_vertices) - len(used),
        unused_vertices=num_vertices - len(used),
        consistently_oriented=len(unique_keys(half_keys)) == len(half_keys),
    )


def _count_fans(faces: Int[IntArray, "F 3"], num_vertices: int) -> int:
    """Corners joined across shared edges: at a manifold vertex they form exactly one fan."""
    quads, pairs = hinges(faces, num_vertices)

    def corner(face: IntArray, vertex: IntArray) -> IntArray:
        return 3 * face + np.argmax(faces[face] == vertex[:, None], axis=1)

    rows = np.concatenate([corner(pairs[:, 0], quads[:, 0]), corner(pairs[:, 0], quads[:, 1])])
    cols = np.concatenate([corner(pairs[:, 1], quads[:, 0]), corner(pairs[:, 1], quads[:, 1])])
    graph = sp.coo_matrix((np.ones(len(rows)), (rows, cols)), (3 * len(faces), 3 * len(faces)))
    return int(connected_components(graph, directed=False)[0])
