"""Discs that hold parts of a triangle mesh: a lower bound of the distance that costs a fraction of it (host side)."""

import numpy as np
from jaxtyping import Float, Int

SLACK = 1e-9
"""Bounds may come out too large by less than this, metres, since they are rounded."""


class Discs:
    """One disc for each part of a mesh, round its centre and in its plane."""

    def __init__(
        self, centres: Float[np.ndarray, "S 3"], normals: Float[np.ndarray, "S 3"], radii: Float[np.ndarray, " S"]
    ) -> None:
        """Prepare discs.

        Args:
            centres: Metres.
            normals: Of unit length; zero makes a ball of a disc.
            radii: Metres.
        """
        self.centres, self.normals, self.radii = centres, normals, radii
        offset = np.einsum("sc,sc->s", centres, normals)
        # One row for each disc, so that one is read from one place.
        self._rows = np.column_stack([normals, offset, radii])

    def distance(
        self, points: Float[np.ndarray, "N 3"], disc: Int[np.ndarray, " N"], far: Float[np.ndarray, " N"]
    ) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
        """Distance of each point from a disc, and its height over the plane of that disc, metres.

        Args:
            points: Metres.
            disc: The disc of each point.
            far: The distance of each point from the centre of that disc, metres.
        """
        row = self._rows.take(disc, axis=0)
        height = np.einsum("nc,nc->n", points, row[:, :3]) - row[:, 3]
        squared = height * height
        beside = np.maximum(np.sqrt(np.maximum(far * far - squared, 0.0)) - row[:, 4], 0.0)
        return np.sqrt(squared + beside * beside), height
