"""Move a drape out of the body by the smallest displacement, and check it by exact distances (host side).

Constraints are that samples of the cloth (its vertices, the middles of its edges and faces) keep a clearance from the
body. Each round linearises them at the closest points, takes the displacement of least squares norm that satisfies
them (Hildreth 1957, all multipliers at once), and measures again what has moved. Vertices are measured; of the other
samples those that bounds do not clear of the body are. So nothing of the result has to be believed.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from tryon_jax.checks import check_finite, check_range
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.mesh.normals import vertex_normals
from tryon_jax.mesh.points_beside import PointsBeside
from tryon_jax.mesh.topology import unique_edges

CLEARANCE = 0.002
"""Default distance that is kept from the body, metres: more than the body bulges between samples 1 cm apart."""

EXACT_BELOW = 0.02
"""Distances of vertices are exact up to this, metres."""

_NEAR = 0.006
"""Samples that are farther from where they should be than this take no part in a round, metres."""
_INNER_STEPS = 60
# Rings of samples round what is missing that a step looks at first.
_RINGS = 1


@dataclass(frozen=True)
class PushedOut:
    """A drape outside the body, with the evidence."""

    vertices: Float[np.ndarray, "V 3"]
    """Positions after the push, metres, in the precision of those before."""
    distance: Float[np.ndarray, " V"]
    """Distance of each of these from the body, metres, negative inside; exact up to `EXACT_BELOW`, beyond it may be a
    little too large."""
    inside_before: float
    """Share of the samples that were inside the body."""
    deepest_before: float
    """Depth of the deepest sample before, metres; 0 when none was inside."""
    inside: float
    """Share of the samples that are inside now."""
    deepest: float
    """Depth of the deepest sample now, metres; 0 when none is inside."""
    largest_move: float
    """Largest displacement of a vertex, metres."""
    rounds: int
    """Rounds that were needed; 0 for a drape that kept its clearance."""

    @property
    def is_outside(self) -> bool:
        """True when no sample is inside the body."""
        return self.inside == 0.0


def sample_matrix(faces: Int[np.ndarray, "F 3"], num_vertices: int) -> sp.csr_array:
    """[V + E + F, V]: vertices, middles of edges and middles of faces as averages of the vertices."""
    edges, _ = unique_edges(faces, num_vertices)
    parts = [(np.arange(num_vertices)[:, None], 1.0), (edges, 0.5), (np.asarray(faces, np.int64), 1.0 / 3.0)]
    columns = np.concatenate([index.ravel() for index, _ in parts])
    values = np.concatenate([np.full(index.size, weight) for index, weight in parts])
    lengths = np.concatenate([np.full(len(index), index.shape[1]) for index, _ in parts])
    rows = np.repeat(np.arange(len(lengths)), lengths)
    return sp.coo_array((values, (rows, columns)), shape=(len(lengths), num_vertices)).tocsr()


def push_out(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    body: ClosedSurface,
    clearance: float = CLEARANCE,
    max_rounds: int = 40,
) -> PushedOut:
    """Move a garment out of a body as little as possible.

    Args:
        vertices: The drape, metres, without padding.
        faces: Its triangles.
        body: The body's surface, in the shape that the garment was draped on.
        clearance: Distance to keep, metres; cloth that keeps it is not touched.
        max_rounds: Rounds at most. `PushedOut.is_outside` says whether they were enough.

    Raises:
        ValueError: for vertices that are not finite, or a clearance outside 0 to 5 cm.
    """
    precision = np.result_type(vertices, np.float32)
    points = check_finite("vertices", vertices).astype(np.float64)
    check_range("clearance", clearance, 0.0, 0.05, "m")
    start = points.copy()
    samples = sample_matrix(faces, len(points))
    # Aim a little farther: the body is not flat, so the linearised step falls short.
    aim = clearance + 1e-4
    at = _Samples(samples, body, points, faces, aim)
    before = at.distance.copy()
    rounds = 0
    while rounds < max_rounds and (at.distance < clearance).any():
        move = _least_move(samples, at, aim)
        # What is measured is what is handed out.
        points = (points + move).astype(precision).astype(np.float64)
        at.move(points)
        rounds += 1
    return PushedOut(
        vertices=points.astype(precision),
        distance=at.of_vertices(),
        inside_before=float((before < 0).mean()),
        deepest_before=float(max(0.0, -before.min())),
        inside=float((at.distance < 0).mean()),
        deepest=float(max(0.0, -at.distance.min())),
        largest_move=float(np.linalg.norm(points - start, axis=1).max()),
        rounds=rounds,
    )


class _Samples:
    """Samples of a cloth, measured where it matters."""

    distance: Float[np.ndarray, " S"]
    """Metres, negative inside. Infinite where it was not measured: such a sample is outside and farther than `aim`."""
    away: Float[np.ndarray, "S 3"]
    """Direction in which the distance grows, where it was measured."""

    def __init__(
        self, samples: sp.csr_array, body: ClosedSurface, vertices: np.ndarray, faces: np.ndarray, aim: float
    ) -> None:
        """Measure all vertices, and what else may be closer than `aim` or inside."""
        self._matrix, self._body, self._exact_below = samples, body, aim + _NEAR
        self._at = samples @ vertices
        count = len(vertices)
        # The first vertex of each edge and of each face.
        owner = samples.indices[samples.indptr[count:-1]]
        across = vertex_normals(vertices, faces)
        beside = PointsBeside(self._at[count:], owner, vertices, across, aim, EXACT_BELOW - aim)
        found = body.closest(vertices, EXACT_BELOW, beside)
        self.distance, self.away = np.full(len(self._at), np.inf), np.zeros((len(self._at), 3))
        self.distance[:count], self.away[:count] = found.distance, found.away
        self._again = np.zeros(count, bool)
        unclear = count + np.flatnonzero(~(beside.clear & (found.distance[owner] > 0)))
        deep = np.flatnonzero(found.distance < -self._exact_below)
        self._measure(np.concatenate([deep, unclear]))

    def move(self, vertices: Float[np.ndarray, "V 3"]) -> None:
        """Measure again what is moved by these positions of the vertices, metres."""
        moved = self._matrix @ vertices
        stale = np.flatnonzero((moved != self._at).any(axis=1))
        self._at = moved
        self._measure(stale)

    def look(self, rows: Int[np.ndarray, " N"]) -> None:
        """Measure those of these samples that were not."""
        self._measure(rows[np.isinf(self.distance[rows])])

    def of_vertices(self) -> Float[np.ndarray, " V"]:
        """Distance of each vertex, exact up to `EXACT_BELOW`."""
        distance = self.distance[: len(self._again)].copy()
        rows = np.flatnonzero(self._again & (np.abs(distance) > self._exact_below))
        distance[rows] = self._body.closest(self._at[rows], EXACT_BELOW).distance
        return distance

    def _measure(self, rows: np.ndarray) -> None:
        found = self._body.closest(self._at[rows], self._exact_below)
        self.distance[rows], self.away[rows] = found.distance, found.away
        self._again[rows[rows < len(self._again)]] = True


def _least_move(samples: sp.csr_array, at: _Samples, aim: float) -> Float[np.ndarray, "V 3"]:
    """Displacement x of least norm with away · (samples x) ≥ aim − distance, by projected ascent on the multipliers.

    A multiplier stays zero where nothing is missing and those of all samples that share a vertex are zero. So only the
    samples around what is missing are looked at, and the result is that of all of them as long as the outermost ring
    is never pushed; where it is, more are taken.
    """
    reached, rings = at.distance < aim, _RINGS
    while True:
        inner = reached
        for _ in range(rings):
            inner = reached
            reached = samples @ (samples.T @ inner.astype(np.float64)) > 0
        rows = np.flatnonzero(reached)
        at.look(rows)
        rows = rows[at.distance[rows] < aim + _NEAR]
        local, away = samples[rows], at.away[rows]
        multiplier, pushed = _multipliers(local, away, aim - at.distance[rows])
        if not (pushed & ~inner[rows]).any():
            return local.T @ (multiplier[:, None] * away)
        rings *= 2


def _multipliers(
    samples: sp.csr_array, away: Float[np.ndarray, "S 3"], missing: Float[np.ndarray, " S"]
) -> tuple[Float[np.ndarray, " S"], Bool[np.ndarray, " S"]]:
    """The multipliers of all these samples, and which of them were positive at any step."""
    pairs = (samples @ samples.T).tocsr()
    cosines = pairs.tocoo()
    weight = cosines.data * np.einsum("sc,sc->s", away[cosines.coords[0]], away[cosines.coords[1]])
    gram = sp.coo_array((weight, cosines.coords), shape=pairs.shape).tocsr()
    # Scaling by absolute row sums bounds the spectrum by 1, so that plain ascent converges.
    step = 1.0 / np.maximum(abs(gram).sum(axis=1), 1e-12)
    multiplier, pushed = np.zeros(len(missing)), np.zeros(len(missing), bool)
    previous, momentum = multiplier, 1.0
    for _ in range(_INNER_STEPS):
        # Nesterov's extrapolation, restarted by the projection where a constraint becomes inactive.
        following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum**2))
        ahead = multiplier + (momentum - 1.0) / following * (multiplier - previous)
        previous, momentum = multiplier, following
        multiplier = np.maximum(ahead + step * (missing - gram @ ahead), 0.0)
        pushed |= multiplier > 0
    return multiplier, pushed
