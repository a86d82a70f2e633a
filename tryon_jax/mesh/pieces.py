"""Which pieces of a file are cloth: bodies and accessories are closed, buttons are small. Free of units."""

from collections.abc import Sequence

import numpy as np

from tryon_jax.mesh.loaded_garment import Piece
from tryon_jax.mesh.quality import areas

SMALL = 0.01
"""Pieces with less than this share of the largest cloth's area are no cloth."""
OPEN = 0.25
"""The longest open border of cloth, over its largest extent, is at least this: a body has openings at its eyes only."""


def why_no_cloth(pieces: Sequence[Piece]) -> list[str]:
    """For each piece why it is no cloth, in words; empty for cloth."""
    reasons = ["" if _openness(piece) >= OPEN else _closed(piece) for piece in pieces]
    size = [float(areas(piece.vertices, piece.faces).sum()) for piece in pieces]
    largest = max((area for area, reason in zip(size, reasons, strict=True) if not reason), default=0.0)
    small = [not reason and area < SMALL * largest for area, reason in zip(size, reasons, strict=True)]
    return ["is too small for cloth" if tiny else reason for tiny, reason in zip(small, reasons, strict=True)]


def _openness(piece: Piece) -> float:
    if not piece.loops:
        return 0.0
    border = piece.vertices[piece.loops[0]]
    around = np.linalg.norm(border - np.roll(border, 1, axis=0), axis=1).sum()
    return float(around / np.ptp(piece.vertices, axis=0).max())


def _closed(piece: Piece) -> str:
    return "is all but closed, as a body is" if piece.loops else "is closed, as a body or an accessory is"


def choose_cloth(
    pieces: Sequence[Piece], chosen: Sequence[int] = (), name: str = "the garment"
) -> tuple[list[Piece], list[str]]:
    """The pieces that are cloth, and what is said about the others.

    Args:
        pieces: the pieces of a file, the largest area first.
        chosen: numbers from 1 of those to take, whatever they look like; all that look like cloth when empty.
        name: what messages call the file.

    Raises:
        ValueError: a number that no piece has, a number given twice, or no piece that is cloth.
    """
    reasons = why_no_cloth(pieces)
    if chosen:
        wrong = [number for number in chosen if not 1 <= number <= len(pieces)]
        if wrong or len(set(chosen)) != len(chosen):
            raise ValueError(f"piece = {list(chosen)} must be different numbers from 1 to {len(pieces)}, in {name}")
        left = [f"left out piece {k}" for k in range(1, len(pieces) + 1) if k not in chosen]
        return [pieces[k - 1] for k in sorted(chosen)], left
    taken = [piece for piece, reason in zip(pieces, reasons, strict=True) if not reason]
    words = [
        f"left out piece {number} ({len(piece.vertices)} vertices): it {reason}"
        for number, (piece, reason) in enumerate(zip(pieces, reasons, strict=True), start=1)
        if reason
    ]
    if not taken:
        raise ValueError(
            f"{name} has no piece that is cloth: {'; '.join(words)}. Cloth is a single layer with open borders; choose "
            "pieces by number where this is wrong"
        )
    return taken, words
