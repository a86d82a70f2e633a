"""A garment of a user's own, ready for the networks: read, and settled on the mean body by the simulator. The networks
learned from drapes. A mesh that was draped on another body, or modelled by hand, becomes a drape of this body by
simulation.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.graph.resample import resample
from tryon_jax.mesh.closest_points import MeshSearch
from tryon_jax.mesh.loaded_garment import LoadedGarment
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.types import Body
from tryon_jax.wear.fit import pattern_of
from tryon_jax.wear.intake import TakenIn, take_in
from tryon_jax.wear.placement import Placing
from tryon_jax.wear.simulate import Pattern, Progress, Simulator

SETTLE_FABRIC = "gray-interlock"
"""Softer than most: what settles in it settles in others."""
FINEST = 6000
"""Meshes of more vertices move with an evenly spaced copy, which is settled in their place."""
SETTLE_AREA = 1.78e-4
"""Mean area of the copy's triangles, square metres: that of the simulated garments."""


@dataclass(frozen=True)
class OwnOptions:
    """How a mesh of one's own is taken in."""

    placing: Placing = field(default_factory=Placing)
    piece: tuple[int, ...] = ()
    """Numbers from 1, the largest first, of the pieces that are cloth; found when empty."""
    settle: bool = True
    """Hang it on the mean body by simulation first."""


@dataclass(frozen=True, eq=False)
class OwnGarment:
    """A garment of a user's own on the mean body, with its rest shape."""

    name: str
    loaded: LoadedGarment
    """As it hangs, metres."""
    pattern: Pattern
    """As it is unstretched: its true-size texture coordinates, or the mesh as it came."""
    remarks: tuple[str, ...]
    """What was found and done, one sentence each."""
    has_pattern: bool = False
    """Whether the rest shape is that of the file's texture coordinates."""

    @property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """As it hangs on the mean body, metres."""
        return self.loaded.joined()[0]


def bring_own(
    path: str | Path,
    body: Body,
    options: OwnOptions | None = None,
    *,
    simulator: Simulator | None = None,
    progress: Progress | None = None,
    name: str | None = None,
) -> OwnGarment:
    """Read a garment's mesh and make it a drape on the mean shape of `body`.

    Args:
        path: an OBJ, GLB, glTF or PLY file.
        body: the body of the networks.
        options: what is known of the file, and whether to settle it.
        simulator: for `body`; made when None.
        progress: told while it settles.
        name: what messages call it; the file's name when None.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: see `take_in`; or it does not settle (`wear.simulate.NotSettled`).
    """
    options = options or OwnOptions()
    called = Path(path).name if name is None else name
    taken = take_in(path, body, options.placing, options.piece, called)
    vertices, faces = taken.garment.joined()
    texture = taken.garment.texture()
    uv, faces_uv = pattern_of(vertices, faces, *texture)
    pattern, drawn = Pattern(faces, uv, faces_uv), uv is texture[0]
    if not options.settle:
        return OwnGarment(called, taken.garment, pattern, taken.remarks, drawn)
    simulator = simulator or Simulator(body)
    settled, words = _settled(taken, pattern, simulator, progress)
    return OwnGarment(called, taken.garment.moved(settled), pattern, (*taken.remarks, words), drawn)


def _settled(
    taken: TakenIn, pattern: Pattern, simulator: Simulator, progress: Progress | None
) -> tuple[Float[np.ndarray, "V 3"], str]:
    """The garment hung on the mean body, and what is said about it."""
    fabric = load_fabric(SETTLE_FABRIC)
    vertices, faces = taken.garment.joined()
    if len(vertices) <= FINEST:
        result = simulator.settle(vertices, pattern, fabric, progress)
        return result.vertices, f"settled it on the mean body by simulation: {result.words()}"
    coarse, coarse_faces = resample(vertices, faces, SETTLE_AREA)
    result = simulator.settle(coarse, Pattern(coarse_faces, *pattern_of(coarse, coarse_faces)), fabric, progress)
    moved = _carried(vertices, coarse, coarse_faces, result.vertices)
    return moved, f"settled a copy of {len(coarse)} vertices, which carries it: {result.words()}"


def _carried(
    vertices: Float[np.ndarray, "V 3"],
    before: Float[np.ndarray, "N 3"],
    faces: Int[np.ndarray, "M 3"],
    after: Float[np.ndarray, "N 3"],
) -> Float[np.ndarray, "V 3"]:
    """Vertices moved as the closest points of a mesh move."""
    found = MeshSearch(before, faces).closest(vertices)
    corners = faces[found.face]
    return vertices + np.einsum("vk,vkc->vc", found.weights, (after - before)[corners])
