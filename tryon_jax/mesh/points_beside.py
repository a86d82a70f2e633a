"""What the search round a few points shows of many that lie beside them (host side).

Of most samples of a cloth it is enough to know that they are clear of a body. The parts of the body near a vertex are
found anyway, when its own distance is measured; bounds of the distance from those parts clear what lies beside it.
"""

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.mesh.discs import SLACK, Discs


class PointsBeside:
    """Points that each lie beside another one, their owner, whose neighbourhood in a mesh is searched."""

    def __init__(
        self,
        points: Float[np.ndarray, "P 3"],
        owner: Int[np.ndarray, " P"],
        owners: Float[np.ndarray, "V 3"],
        across: Float[np.ndarray, "V 3"],
        limit: float,
        farthest: float,
    ) -> None:
        """Nothing is ruled out yet: all count as clear.

        Args:
            points: Metres, finite.
            owner: Which of `owners` each lies beside.
            owners: Metres.
            across: Unit vectors, best those in whose direction points differ least from their owner.
            limit: Points are clear when they are surely farther than this from the mesh, metres.
            farthest: Points farther from their owner than this, metres, are not clear.
        """
        self.limit = limit
        self._points, self._owners, self._across = points, owners, across
        # Rows are taken, which is several times as fast as indexing them.
        offset = points - owners.take(owner, axis=0)
        distance = np.linalg.norm(offset, axis=1)
        self.clear = distance <= farthest
        taken = np.flatnonzero(self.clear)
        order = taken[np.argsort(owner[taken], kind="stable")]
        self._order, self._owner = order, owner
        self._count = np.bincount(owner[taken], minlength=len(owners))
        self._first = np.cumsum(self._count) - self._count
        self._spread, self._lift = np.zeros((2, len(owners)))
        np.maximum.at(self._spread, owner[taken], distance[taken])
        lift = np.abs(np.einsum("pc,pc->p", offset, across.take(owner, axis=0)))
        np.maximum.at(self._lift, owner[taken], lift[taken])
        self.reach = limit + float(self._spread.max(initial=0.0))
        """How far round the owners the mesh has to be searched, metres."""

    def rule_out(
        self, discs: Discs, row: Int[np.ndarray, " N"], disc: Int[np.ndarray, " N"], far: Float[np.ndarray, " N"]
    ) -> None:
        """Clear no longer what may be within the limit of a disc, or behind it as seen from its owner.

        Args:
            discs: Of the mesh.
            row: Owners, paired with all discs that are within `reach` of them.
            disc: The disc of each pair.
            far: Distance of each owner from the centre of that disc, metres.
        """
        limit = self.limit + SLACK
        near = np.flatnonzero(far - discs.radii[disc] < limit + self._spread[row])
        row, disc, far = row[near], disc[near], far[near]
        distance, height = discs.distance(self._owners.take(row, axis=0), disc, far)
        # Points beside an owner differ in height from it by no more than this.
        cosine = np.abs(np.einsum("nc,nc->n", discs.normals.take(disc, axis=0), self._across.take(row, axis=0)))
        change = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0)) * self._spread[row] + cosine * self._lift[row]
        near = np.flatnonzero((distance < limit + self._spread[row]) & (np.abs(height) - change < limit))
        row, disc, height = row[near], disc[near], height[near]
        # Each of these discs with all points beside that owner.
        count = self._count[row]
        pair = np.repeat(np.arange(len(row)), count)
        start = self._first[row] - (np.cumsum(count) - count)
        point = self._order[start[pair] + np.arange(len(pair))]
        disc, before = disc[pair], height[pair]
        at = self._points.take(point, axis=0)
        offset = at - discs.centres.take(disc, axis=0)
        distance, after = discs.distance(at, disc, np.sqrt(np.einsum("nc,nc->n", offset, offset)))
        within = distance < limit
        self.clear[point[within]] = False
        other = np.flatnonzero(~within & (before * after <= 0))
        point = point[other]
        behind = self._meets(discs, point, disc[other], before[other], after[other])
        self.clear[point[behind]] = False

    def _meets(
        self, discs: Discs, point: np.ndarray, disc: np.ndarray, before: np.ndarray, after: np.ndarray
    ) -> np.ndarray:
        """Whether the way from a point's owner, which is `before` over the plane of a disc, may meet that disc."""
        flat = before == after
        share = before / np.where(flat, 1.0, before - after)
        start, end = self._owners[self._owner[point]], self._points[point]
        met = start + share[:, None] * (end - start) - discs.centres[disc]
        return flat | (np.linalg.norm(met, axis=1) < discs.radii[disc] + SLACK)
