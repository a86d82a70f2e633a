"""A garment that a user brought: clean pieces, and what was repaired in them."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

SMALLEST_OPENING = 0.08
"""Open borders shorter than this, metres, are holes: no arm fits through."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One clean, connected, consistently oriented surface."""

    vertices: Float[np.ndarray, "V 3"]
    """Metres, y up."""
    faces: Int[np.ndarray, "F 3"]
    """Counter-clockwise seen from outside."""
    uv: Float[np.ndarray, "U 2"] | None
    """Texture coordinates as in the file, or None."""
    faces_uv: Int[np.ndarray, "F 3"] | None
    """Triangles as indices into `uv`, or None."""
    loops: tuple[Int[np.ndarray, " _"], ...]
    """Open borders, longest first."""


@dataclass(frozen=True, eq=False)
class LoadedGarment:
    """What `load_garment` found in a file."""

    pieces: tuple[Piece, ...]
    """Connected pieces, the largest area first."""
    repairs: tuple[str, ...]
    """What was changed, one sentence each; empty for a file that was clean."""

    @property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Vertices of the largest piece, metres."""
        return self.pieces[0].vertices

    @property
    def faces(self) -> Int[np.ndarray, "F 3"]:
        """Triangles of the largest piece."""
        return self.pieces[0].faces

    def joined(self) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
        """Vertices, metres, and triangles of all pieces together."""
        starts = np.cumsum([0, *(len(piece.vertices) for piece in self.pieces[:-1])])
        faces = [piece.faces + start for piece, start in zip(self.pieces, starts, strict=True)]
        return np.concatenate([piece.vertices for piece in self.pieces]), np.concatenate(faces)

    def moved(self, vertices: Float[np.ndarray, "V 3"]) -> "LoadedGarment":
        """The same with other vertices, as `joined` lists them."""
        ends = np.cumsum([len(piece.vertices) for piece in self.pieces])
        parts = np.split(np.asarray(vertices), ends[:-1])
        pieces = [replace(piece, vertices=part) for piece, part in zip(self.pieces, parts, strict=True)]
        return replace(self, pieces=tuple(pieces))

    def texture(self) -> tuple[Float[np.ndarray, "U 2"], Int[np.ndarray, "F 3"]] | tuple[None, None]:
        """Texture coordinates of all pieces together and their use by face corners; nothing where a piece has none."""
        uv = [piece.uv for piece in self.pieces if piece.uv is not None]
        faces_uv = [piece.faces_uv for piece in self.pieces if piece.faces_uv is not None]
        if not len(uv) == len(faces_uv) == len(self.pieces):
            return None, None
        starts = np.cumsum([0, *(len(one) for one in uv[:-1])])
        return np.concatenate(uv), np.concatenate([f + start for f, start in zip(faces_uv, starts, strict=True)])


def refuse_holes(piece: Piece, name: str) -> None:
    """Raise `ValueError` for an open border of a piece in metres that is too short for an arm."""
    for loop in piece.loops:
        length = border_length(piece.vertices, loop)
        if length < SMALLEST_OPENING:
            x, y, z = piece.vertices[loop].mean(axis=0)
            raise ValueError(
                f"{name} has a hole of {len(loop)} edges, {length:.3f} m around, near ({x:.3f}, {y:.3f}, {z:.3f}) m: "
                "fill it"
            )


def border_length(vertices: Float[np.ndarray, "V 3"], loop: Int[np.ndarray, " L"]) -> float:
    """Length of an open border."""
    return float(np.linalg.norm(vertices[loop] - vertices[np.roll(loop, 1)], axis=1).sum())
