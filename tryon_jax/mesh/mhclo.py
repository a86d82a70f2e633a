"""Clothes of MakeHuman: an OBJ file, and beside it an .mhclo file that binds each vertex to three of the base mesh."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.checks import check_file

DECIMETRE = 0.1
"""The files' unit, metres."""


@dataclass(frozen=True, eq=False)
class Binding:
    """How the vertices of a garment hang on a base mesh."""

    base_mesh: str
    """Name of the base mesh."""
    mesh: Path
    """The OBJ file."""
    corners: Int[np.ndarray, "V 3"]
    """Vertices of the base mesh."""
    weights: Float[np.ndarray, "V 3"]
    offsets: Float[np.ndarray, "V 3"]
    """Metres, on the body that the garment was made on."""
    scales: tuple[tuple[int, int, float] | None, ...]
    """For x, y and z: two vertices of the base mesh and their distance along the axis on that body, metres."""

    def vertices(self, base: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "V 3"]:
        """The garment's vertices for a base mesh of these vertices, metres.

        Args:
            base: All vertices of the base mesh, metres.

        Raises:
            ValueError: The binding names vertices that the base mesh does not have.
        """
        named = int(self.corners.max(initial=0))
        if named >= len(base):
            raise ValueError(f"{self.mesh.name} is bound to vertex {named} of a base mesh that has {len(base)}")
        scale = np.ones(3)
        for axis, entry in enumerate(self.scales):
            if entry is not None and max(entry[:2]) < len(base):
                first, second, distance = entry
                # Another pose may bring the two vertices together: no reason to flatten the garment.
                scale[axis] = np.clip(abs(base[first, axis] - base[second, axis]) / distance, 0.5, 2.0)
        return np.einsum("vk,vkc->vc", self.weights, base[self.corners]) + self.offsets * scale[None]


def read_binding(path: str | Path) -> Binding:
    """Read an .mhclo file.

    Args:
        path: The file; the OBJ file that it names must lie beside it.

    Raises:
        FileNotFoundError: The file or its OBJ file is missing.
        ValueError: A line cannot be read, or there is no binding in it.
    """
    file = check_file("garment", path)
    header: dict[str, list[str]] = {}
    rows: list[tuple[list[int], list[float]]] = []
    in_vertices = False
    for number, line in enumerate(file.read_text(encoding="utf-8", errors="replace").splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if not words[0].lstrip("-").isdigit():
            in_vertices = words[0] == "verts"
            header.setdefault(words[0], words[1:])
        elif in_vertices:
            rows.append(_row(words, f"garment {str(file)!r}, line {number}"))
    if not rows:
        raise ValueError(f"garment {str(file)!r} binds no vertices")
    mesh = file.parent / " ".join(header.get("obj_file", [f"{file.stem}.obj"]))
    check_file(f"mesh of {file.name}", mesh)
    numbers = np.array([values for _, values in rows])
    return Binding(
        header.get("basemesh", ["hm08"])[0],
        mesh,
        np.array([corners for corners, _ in rows]),
        numbers[:, :3],
        DECIMETRE * numbers[:, 3:],
        tuple(_scale(header.get(f"{axis}_scale"), axis, str(file)) for axis in "xyz"),
    )


def _row(words: Sequence[str], where: str) -> tuple[list[int], list[float]]:
    """One vertex: a vertex of the base mesh alone, or three with weights and an offset."""
    try:
        if len(words) == 1:
            return [int(words[0])] * 3, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        corners, values = [int(word) for word in words[:3]], [float(word) for word in words[3:]]
    except ValueError:
        corners, values = [], []
    if len(values) == 3:
        values += [0.0, 0.0, 0.0]
    if len(corners) != 3 or len(values) != 6 or min(corners) < 0 or not np.isfinite(values).all():
        raise ValueError(f"{where}: {' '.join(words)[:60]!r} is no binding (three vertices, three weights, an offset)")
    return corners, values


def _scale(words: Sequence[str] | None, axis: str, name: str) -> tuple[int, int, float] | None:
    if words is None:
        return None
    try:
        first, second, distance = int(words[0]), int(words[1]), DECIMETRE * float(words[2])
    except (ValueError, IndexError):
        first, second, distance = -1, -1, 0.0
    if min(first, second) < 0 or not distance > 0:
        raise ValueError(f"garment {name!r}: {axis}_scale {' '.join(words)!r} is not two vertices and a distance")
    return first, second, distance
