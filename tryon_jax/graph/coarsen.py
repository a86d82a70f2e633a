"""Halve the vertices of a mesh by quadric edge collapse (Garland and Heckbert 1997), many collapses at a time.

A collapse d → k moves vertex d onto its neighbour k (half-edge collapse), so every coarse vertex is one of the fine
ones. Each round evaluates the cheapest allowed collapse of every vertex and performs a set of them that do not
touch each other: the result is that of the sequential method with slightly relaxed order, the exact
vertex count is met, and everything is NumPy. Sequential implementations that take a face count as their target
overshoot the vertex count, move or freeze borders and can pinch the surface; here a collapse is refused when it
would change the topology (link condition), flip or flatten a triangle, pull a border inwards or raise a valence
above `MAX_VALENCE`.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tryon_jax.mesh.topology import directed_edges, edge_keys

MAX_VALENCE = 11
"""No collapse makes a vertex with more neighbours than this."""

LENGTH_WEIGHT = 0.02
"""Default weight of edge lengths beside the quadric errors."""

_BORDER_WEIGHT = 10.0
# Of the allowed collapses, a round considers the cheapest part, and performs at most this part of what is missing.
_CHEAP_PART = 0.6
_MIN_NORMAL_COSINE = 0.2
_MIN_SLIVER = 0.03


@dataclass(frozen=True)
class CoarseMesh:
    """One coarsening step."""

    faces: Int[np.ndarray, "f 3"]
    """Triangles among the coarse vertices."""
    kept: Int[np.ndarray, " m"]
    """Fine vertex that each coarse vertex is; increasing."""
    cluster: Int[np.ndarray, " n"]
    """Coarse vertex that each fine vertex was collapsed into."""


def _planes(corners: Float[np.ndarray, "F 3 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Unit plane (normal, offset) and area of each triangle; a degenerate triangle has a zero plane."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(double_area, 1e-300)[:, None]
    return np.column_stack([normal, -np.einsum("fi,fi->f", normal, corners[:, 0])]), 0.5 * double_area


def _scatter_add(target: np.ndarray, index: np.ndarray, values: np.ndarray) -> None:
    """target[index] += values with repeated indices; column by column, which is far faster than `np.add.at`."""
    for column in range(target.shape[1]):
        target[:, column] += np.bincount(index, values[:, column], minlength=len(target))


# Upper triangle of a symmetric 4 × 4 matrix, and how often each entry counts in a quadratic form.
_UPPER = np.triu_indices(4)
_MULTIPLICITY = np.where(_UPPER[0] == _UPPER[1], 1.0, 2.0)


def _quadrics(vertices: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, "n 10"]:
    """Area-weighted plane quadrics per vertex, with stiff planes through the borders, normal to the surface."""
    plane, area = _planes(vertices.take(faces, axis=0))
    of_face = (plane[:, _UPPER[0]] * plane[:, _UPPER[1]]) * (area / 3.0)[:, None]
    quadric = np.zeros((len(vertices), 10))
    for corner in range(3):
        _scatter_add(quadric, faces[:, corner], of_face)
    half = directed_edges(faces)
    _, first, counts = np.unique(edge_keys(half, len(vertices)), return_index=True, return_counts=True)
    border = first[counts == 1]
    start, end = half[border].T
    along = vertices.take(end, axis=0) - vertices.take(start, axis=0)
    across = np.cross(plane[border % len(faces), :3], along)
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
    wall = np.column_stack([across, -np.einsum("bi,bi->b", across, vertices[start])])
    weight = 0.5 * _BORDER_WEIGHT * np.einsum("bi,bi->b", along, along)
    of_border = (wall[:, _UPPER[0]] * wall[:, _UPPER[1]]) * weight[:, None]
    _scatter_add(quadric, start, of_border)
    _scatter_add(quadric, end, of_border)
    return quadric


def _homogeneous(vertices: np.ndarray) -> Float[np.ndarray, "n 10"]:
    """Products of homogeneous coordinates, so that a quadric's error at a vertex is a dot product."""
    point = np.column_stack([vertices, np.ones(len(vertices))])
    return point[:, _UPPER[0]] * point[:, _UPPER[1]] * _MULTIPLICITY


class _Adjacency:
    """Half-edges of the current mesh in both directions, sorted by `keys` = start · n + end, with their face counts."""

    def __init__(self, faces: np.ndarray, n: int) -> None:
        a, b, c = faces.T
        keys = np.sort(np.concatenate([a * n + b, b * n + c, c * n + a, b * n + a, c * n + b, a * n + c]))
        last = np.append(keys[1:] != keys[:-1], True)
        self.keys = keys[last]
        self.num_faces = np.diff(np.flatnonzero(last), prepend=-1)
        self.start, self.end = np.divmod(self.keys, n)
        self.valence = np.bincount(self.start, minlength=n)
        self.first = np.concatenate([[0], np.cumsum(self.valence)])
        self.border = np.zeros(n, bool)
        self.border[self.end[self.num_faces == 1]] = True
        self.frozen = np.zeros(n, bool)
        self.frozen[self.end[self.num_faces > 2]] = True
        self.used = np.flatnonzero(self.valence)

    def smallest(self, values: np.ndarray) -> np.ndarray:
        """Minimum over the half-edges that start at each used vertex."""
        return np.minimum.reduceat(values, self.first[self.used])

    def rings(self, vertices: np.ndarray) -> Int[np.ndarray, "c w"]:
        """Neighbours of each vertex, padded with −1."""
        width = int(self.valence[vertices].max(initial=1))
        slot = self.first[vertices][:, None] + np.arange(width)
        valid = np.arange(width) < self.valence[vertices][:, None]
        return np.where(valid, self.end[np.minimum(slot, len(self.end) - 1)], -1)


def _link_ok(
    adjacency: _Adjacency, drop: np.ndarray, keep: np.ndarray, num_faces: np.ndarray
) -> Bool[np.ndarray, " c"]:
    """Link condition, plus the cases it does not cover: tetrahedra, lone triangles and too many neighbours."""
    ring_drop, ring_keep = adjacency.rings(drop), adjacency.rings(keep)
    shared = ((ring_drop[:, :, None] == ring_keep[:, None, :]) & (ring_drop[:, :, None] >= 0)).any(axis=2)
    common = shared.sum(axis=1)
    valence_drop, valence_keep = adjacency.valence[drop], adjacency.valence[keep]
    joined = valence_drop + valence_keep - common - 2
    tetrahedron = (num_faces == 2) & (valence_drop == 3) & (valence_keep == 3)
    third = ring_drop[np.arange(len(drop)), shared.argmax(axis=1)]
    lone = (num_faces == 1) & ((adjacency.valence[third] == 2) | ((valence_drop == 2) & (valence_keep == 2)))
    return (common == num_faces) & (joined <= np.maximum(MAX_VALENCE, valence_keep)) & ~tetrahedron & ~lone


def _cross(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Cross product of rows; `np.cross` spends most of its time on axes."""
    result = np.empty_like(x)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[:, i] = x[:, j] * y[:, k] - x[:, k] * y[:, j]
    return result


def _shape_ok(vertices: np.ndarray, faces: np.ndarray, target: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Per vertex d: no triangle around it flips or becomes a sliver when d moves to `target[d]` (−1: not asked)."""
    bad = np.zeros(len(target), bool)
    # Rows are taken, which is several times as fast as indexing them.
    corners = [vertices.take(faces[:, k], axis=0) for k in range(3)]
    normals = _cross(corners[1] - corners[0], corners[2] - corners[0])
    for corner in range(3):
        second, third = (corner + 1) % 3, (corner + 2) % 3
        keep = target[faces[:, corner]]
        asked = np.flatnonzero((keep >= 0) & (keep != faces[:, second]) & (keep != faces[:, third]))
        moved, before = vertices.take(keep[asked], axis=0), normals.take(asked, axis=0)
        to_second = corners[second].take(asked, axis=0) - moved
        to_third = corners[third].take(asked, axis=0) - moved
        after = _cross(to_second, to_third)
        size_before, size_after = np.einsum("fi,fi->f", before, before), np.einsum("fi,fi->f", after, after)
        turned = np.einsum("fi,fi->f", before, after) < _MIN_NORMAL_COSINE * np.sqrt(size_before * size_after)
        longest = np.einsum("fi,fi->f", to_second, to_second)
        longest = np.maximum(longest, np.einsum("fi,fi->f", to_third, to_third))
        bad[faces[asked[turned | (size_after < _MIN_SLIVER * longest**2)], corner]] = True
    return ~bad


def _spread(adjacency: _Adjacency, values: np.ndarray) -> np.ndarray:
    """Minimum of `values` over each closed neighbourhood."""
    result = values.copy()
    used = adjacency.used
    result[used] = np.minimum(result[used], adjacency.smallest(values[adjacency.end]))
    return result


def _independent(adjacency: _Adjacency, drop: np.ndarray, keep: np.ndarray, n: int) -> Int[np.ndarray, " s"]:
    """Candidates, given in order of preference, that can all be performed at once.

    No dropped vertices are neighbours, so no triangle has two of them; no vertex is kept twice; and of two collapses
    whose kept vertices are both neighbours of the other's dropped one only one is done, since together they would
    join the same two vertices by two edges.
    """
    big = len(drop)
    rank = np.full(n, big)
    rank[drop] = np.arange(big)
    chosen = np.zeros(0, np.int64)
    for _ in range(3):
        winners = np.sort(rank[np.flatnonzero((rank < big) & (_spread(adjacency, rank) == rank))])
        if not len(winners):
            break
        first = np.full(n, big)
        np.minimum.at(first, keep[winners], winners)
        winners_alone = winners[first[keep[winners]] == winners]
        chosen = _without_crossings(adjacency, drop, keep, np.sort(np.concatenate([chosen, winners_alone])), n)
        taken = np.ones(n, np.int8)
        taken[drop[chosen]] = 0
        rank[_spread(adjacency, taken) == 0] = big
        rank[drop[winners]] = big
        kept = np.zeros(n, bool)
        kept[keep[chosen]] = True
        rank[drop[kept[keep]]] = big
    return chosen


def _without_crossings(
    adjacency: _Adjacency, drop: np.ndarray, keep: np.ndarray, chosen: np.ndarray, n: int
) -> Int[np.ndarray, " s"]:
    """Leave out the less preferred of two collapses that each keep a neighbour of the vertex the other drops."""
    keeper_of = np.full(n, -1)
    keeper_of[keep[chosen]] = chosen
    ring = adjacency.rings(drop[chosen])
    other = np.where(ring >= 0, keeper_of[ring], -1)
    row, column = np.nonzero((other >= 0) & (other != chosen[:, None]))
    one, two = chosen[row], other[row, column]
    mutual = _find(two * n + one, np.sort(one * n + two)) >= 0
    stays = np.ones(len(drop), bool)
    stays[np.maximum(one, two)[mutual]] = False
    return chosen[stays[chosen]]


def _find(keys: np.ndarray, ordered: np.ndarray) -> Int[np.ndarray, " k"]:
    """Place of each key in an ordered array, -1 where it is not in it."""
    if not len(ordered):
        return np.full(len(keys), -1)
    at = np.minimum(np.searchsorted(ordered, keys), len(ordered) - 1)
    return np.where(ordered[at] == keys, at, -1)


def coarsen(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "F 3"],
    target: int | None = None,
    length_weight: float = LENGTH_WEIGHT,
) -> CoarseMesh:
    """Collapse edges until `target` vertices are left (default ⌈n/2⌉), or none may collapse.

    Open borders shrink only along themselves, components and holes are kept. Fewer collapses than asked happen
    where the mesh is already as coarse as its topology allows (a lone triangle keeps its three vertices), and
    vertices at edges with more than two faces or without any face stay.

    Args:
        vertices: Metres.
        faces: Triangles.
        target: Vertices to keep; ⌈n/2⌉ when None.
        length_weight: How much short edges are preferred to flat places: the default is for hierarchies, 1 and more
            spreads the vertices evenly.

    Returns:
        The coarse mesh, with the coarse vertex that each vertex was merged into.
    """
    n = len(vertices)
    target = math.ceil(n / 2) if target is None else target
    # Unit scale: the thresholds must not depend on the units or the place of the mesh.
    size = float(np.abs(vertices - vertices.mean(axis=0)).max(initial=0.0)) or 1.0
    points = (vertices - vertices.mean(axis=0)) / size
    faces = faces.astype(np.int64)
    root = np.arange(n)
    alive = np.ones(n, bool)
    quadric = _quadrics(points, faces)
    position = _homogeneous(points)
    count_in = np.ones(n)
    mean_area = float(_planes(points.take(faces, axis=0))[1].mean()) if len(faces) else 0.0
    banned = np.zeros(0, np.int64)
    missing = n - target
    while missing > 0 and len(faces):
        adjacency = _Adjacency(faces, n)
        drop, keep, num_faces = adjacency.start, adjacency.end, adjacency.num_faces
        allowed = (num_faces <= 2) & ~adjacency.frozen[drop] & ((num_faces == 1) | ~adjacency.border[drop])
        if len(banned):
            at = _find(banned, adjacency.keys)
            allowed[at[at >= 0]] = False
        edge = points.take(drop, axis=0) - points.take(keep, axis=0)
        regular = length_weight * mean_area * np.einsum("hi,hi->h", edge, edge) * (count_in[drop] + count_in[keep])
        own = np.einsum("nq,nq->n", quadric, position)
        cost = np.einsum("hq,hq->h", quadric.take(drop, axis=0), position.take(keep, axis=0)) + own[keep] + regular
        cost = np.where(allowed, cost, np.inf)
        # The cheapest collapse of each vertex; among equals the first.
        least = np.full(n, np.inf)
        least[adjacency.used] = adjacency.smallest(cost)
        best = np.flatnonzero(allowed & (cost == least[drop]))
        best = best[np.concatenate([[True], np.diff(drop[best]) > 0])] if len(best) else best
        if not len(best):
            break
        best = best[np.argsort(cost[best], kind="stable")]
        best = best[: max(64, int(_CHEAP_PART * len(best)))]
        merged_into = np.full(n, -1)
        merged_into[drop[best]] = keep[best]
        ok = (
            _link_ok(adjacency, drop[best], keep[best], num_faces[best])
            & _shape_ok(points, faces, merged_into)[drop[best]]
        )
        # A refused pair is not asked again on this level unless nothing else is left.
        refused = best[~ok]
        banned = np.concatenate([banned, drop[refused] * n + keep[refused]])
        best = best[ok]
        best = best[_independent(adjacency, drop[best], keep[best], n)][:missing]
        if not len(best):
            if not len(refused):
                break
            continue
        gone, into = drop[best], keep[best]
        root[gone] = into
        alive[gone] = False
        quadric[into] += quadric[gone]
        count_in[into] += count_in[gone]
        missing -= len(best)
        faces = root[faces]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
    while (root[root] != root).any():
        root = root[root]
    kept = np.flatnonzero(alive)
    number = np.full(n, -1)
    number[kept] = np.arange(len(kept))
    return CoarseMesh(number[faces], kept, number[root])
