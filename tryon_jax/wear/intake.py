"""Garments from any file: read, cleaned, cloth told from other pieces, put on the mean body in T-pose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.body.landmarks import Landmarks, load_landmarks
from tryon_jax.body.measurements import measure_vertices
from tryon_jax.mesh.loaded_garment import LoadedGarment, refuse_holes
from tryon_jax.mesh.normals import vertex_normals
from tryon_jax.mesh.pieces import choose_cloth
from tryon_jax.mesh.reading import read_triangles
from tryon_jax.mesh.repair import clean_mesh
from tryon_jax.types import Body
from tryon_jax.wear.arms import LoweredArms
from tryon_jax.wear.bound import SUFFIX, read_bound
from tryon_jax.wear.fit import EASE_AT, girth_round, tape_place
from tryon_jax.wear.placement import Placement, Placing, place


@dataclass(frozen=True, eq=False)
class TakenIn:
    """A garment of a user's own on the mean body."""

    garment: LoadedGarment
    """Its cloth, metres, in T-pose, with the repairs."""
    placement: Placement
    remarks: tuple[str, ...]
    """What was found and done, one sentence each."""


def take_in(
    path: str | Path,
    body: Body,
    placing: Placing | None = None,
    pieces: Sequence[int] = (),
    name: str | None = None,
) -> TakenIn:
    """Read a garment from an OBJ, GLB, glTF, PLY or .mhclo file and put it on the mean shape of `body`.

    Unit, vertical axis, facing, origin and the arms' angle are found where `placing` does not give them, and said.

    Args:
        path: the file.
        body: the body to put it on.
        placing: what is known of the file.
        pieces: numbers from 1, the largest first, of the pieces that are cloth; found when empty.
        name: what messages call the file; its path when None.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a file that cannot be read or mended (see `mesh.reading.load_garment`), no cloth in it, or no place
            on the body where it would lie as a garment does.
    """
    placing = placing or Placing()
    placing.check()
    called = str(path) if name is None else name
    bound = Path(path).suffix.lower() == SUFFIX
    if bound and placing != Placing():
        raise ValueError(f"{called} says itself how it lies on the body: leave unit, axis, turn, offset and pose out")
    vertices, faces, uv = read_bound(path, body) if bound else read_triangles(path)
    clean = clean_mesh(vertices, faces, uv, called)
    cloth, left_out = choose_cloth(clean.pieces, pieces, called)
    garment = replace(clean, pieces=tuple(cloth))
    points, triangles = garment.joined()
    if bound:
        placement = Placement("m", 1.0, "y", 0, np.zeros(3), 0.0, 0.0)
    else:
        placement = place(points, vertex_normals(points, triangles), body, placing, called)
    placed = placement.points(points)
    raised = LoweredArms(body, placement.arms).raise_garment(placed, triangles)
    garment = garment.moved(raised)
    for piece in garment.pieces:
        refuse_holes(piece, called)
    tight = too_small(*garment.joined(), body)
    said = ("put it on the body by its binding to MakeHuman's base mesh",) if bound else placement.words()
    return TakenIn(garment, placement, (*clean.repairs, *left_out, *said, *tight))


def too_small(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    body: Body,
    landmarks: Landmarks | None = None,
) -> list[str]:
    """Where a garment does not reach round the mean body, in words, and by how much.

    Args:
        vertices: Of the garment on the mean body, metres.
        faces: Its triangles.
        body: The body.
        landmarks: Of the body; found when None.
    """
    landmarks = load_landmarks(body) if landmarks is None else landmarks
    skin = np.asarray(body.v_template, np.float64)
    measured = measure_vertices(np.asarray(body.v_template, np.float32), landmarks)
    said = []
    for name in EASE_AT:
        cloth = girth_round(np.asarray(vertices, np.float64), faces, *tape_place(landmarks, name, skin))
        missing = 0.0 if cloth is None else float(measured[name]) - cloth
        if missing > 0.005:
            said.append(
                f"it does not reach round the body: at the {name} {100 * missing:.1f} cm are missing "
                f"({100 * (cloth or 0):.1f} of {100 * float(measured[name]):.1f} cm)"
            )
    return said
