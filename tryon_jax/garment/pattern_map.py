"""From one mesh of a design to another through the flat pattern that both triangulate (host side, NumPy)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.garment.locate import locate
from tryon_jax.garment.mesh import SewnMesh


@dataclass(frozen=True, eq=False)
class PatternMap:
    """Where the vertices of one topology lie on another of the same design."""

    corners: Int[np.ndarray, "V 3"]
    weights: Float[np.ndarray, "V 3"]

    def __call__(self, values: Float[np.ndarray, "S W 3"]) -> Float[np.ndarray, "S V 3"]:
        """Values at the other topology's vertices, interpolated at this one's."""
        return np.einsum("vk,svkc->svc", self.weights, values[:, self.corners])


def pattern_arrays(mesh: SewnMesh) -> dict[str, np.ndarray]:
    """What `map_patterns` reads of a mesh that is not stored."""
    return {"faces": mesh.faces, "uv": mesh.uv, "faces_uv": mesh.faces_uv}


def map_patterns(here: Mapping[str, np.ndarray], there: Mapping[str, np.ndarray]) -> PatternMap:
    """Locate each vertex of one mesh (faces, uv, faces_uv) in the pattern of another one of the same design.

    Front panels are counter-clockwise in UV and back panels clockwise, which tells them apart where they overlap.
    """
    count = int(here["faces"].max()) + 1
    corners, weights = np.zeros((count, 3), np.int64), np.zeros((count, 3))
    fronts = [_fronts(mesh) for mesh in (here, there)]
    for side in (True, False):
        rows, rows_there = fronts[0] == side, fronts[1] == side
        vertex, first = np.unique(here["faces"][rows], return_index=True)
        uv = here["uv"][here["faces_uv"][rows].ravel()[first]]
        face, weight = locate(uv, there["uv"], there["faces_uv"][rows_there])
        corners[vertex], weights[vertex] = there["faces"][rows_there][face], weight
    return PatternMap(corners, weights)


def _fronts(mesh: Mapping[str, np.ndarray]) -> np.ndarray:
    a, b, c = (mesh["uv"][mesh["faces_uv"][:, k]] for k in range(3))
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0
