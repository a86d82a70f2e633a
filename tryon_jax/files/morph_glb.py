"""Binary glTF 2.0 with morph targets: one mesh whose parts move with the same weights, and an animation of these."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tryon_jax.files.atomic import write_bytes
from tryon_jax.files.export import Part, linear_light, split_at_seams, unit_normals

_VERTICES, _INDICES = 34962, 34963
"""What a buffer view holds (glTF 2.0, `bufferView.target`)."""
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


@dataclass(frozen=True)
class MorphedPart:
    """A part, and what each target adds to it."""

    part: Part
    moves: Float[np.ndarray, "T V 3"]
    """Metres at weight 1."""


@dataclass(frozen=True)
class Morphs:
    """The targets that all parts of a mesh share."""

    names: Sequence[str]
    weights: Float[np.ndarray, " T"]
    """Where the sliders stand at first."""
    frames: Float[np.ndarray, "K T"]
    """Weights of an animation, moved between at an even pace."""
    seconds: float
    """From one frame to the next."""
    extras: dict[str, Any]
    """What else a program may want to know, as JSON."""


@dataclass
class _Buffer:
    """The binary part of the file and its tables."""

    data: bytearray = field(default_factory=bytearray)
    views: list[dict[str, Any]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)

    def add(self, array: np.ndarray, target: int | None = None, bounds: bool = False) -> int:
        """Append rows of 4-byte numbers; the number of their accessor."""
        rows = np.ascontiguousarray(array)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": rows.nbytes}
        self.views.append(view if target is None else view | {"target": target})
        self.data += rows.tobytes()
        width = 1 if rows.ndim == 1 else rows.shape[1]
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": 5125 if rows.dtype == np.uint32 else 5126,
            "count": len(rows),
            "type": _TYPES[width],
        }
        if bounds:
            columns = rows.reshape(len(rows), width)
            accessor |= {"min": columns.min(axis=0).tolist(), "max": columns.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_morph_glb(path: str | Path, name: str, parts: Sequence[MorphedPart], morphs: Morphs) -> None:
    """Write one mesh of several parts with morph targets of positions and normals.

    Args:
        path: The file.
        name: Of the mesh.
        parts: Each with its own material.
        morphs: Their targets.

    Raises:
        ValueError: A part, the weights or the frames are not of as many targets as there are names.
    """
    count = len(morphs.names)
    for given in (len(morphs.weights), morphs.frames.shape[1], *(len(part.moves) for part in parts)):
        if given != count:
            raise ValueError(f"cannot write {str(path)!r}: {given} targets where {count} have names")
    buffer = _Buffer()
    times = buffer.add((morphs.seconds * np.arange(len(morphs.frames))).astype(np.float32), bounds=True)
    frames = buffer.add(morphs.frames.astype(np.float32).ravel())
    document = {
        "asset": {"version": "2.0", "generator": "tryon_jax"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0}],
        "meshes": [
            {
                "name": name,
                "primitives": [_primitive(part, number, buffer) for number, part in enumerate(parts)],
                "weights": [float(weight) for weight in morphs.weights],
                "extras": {"targetNames": list(morphs.names), **morphs.extras},
            }
        ],
        "materials": [_material(part.part) for part in parts],
        "animations": [
            {
                "name": "betas",
                "samplers": [{"input": times, "output": frames, "interpolation": "LINEAR"}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
            }
        ],
        "buffers": [{"byteLength": len(buffer.data)}],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(buffer.data)
    header = b"glTF" + np.array([2, size, len(text)], "<u4").tobytes() + b"JSON"
    write_bytes(path, header + text + np.array([len(buffer.data)], "<u4").tobytes() + b"BIN\0" + bytes(buffer.data))


def _primitive(morphed: MorphedPart, number: int, buffer: _Buffer) -> dict[str, Any]:
    part, split = morphed.part, split_at_seams(morphed.part)
    attributes = {
        "POSITION": buffer.add(split.vertices.astype(np.float32), _VERTICES, bounds=True),
        "NORMAL": buffer.add(split.normals.astype(np.float32), _VERTICES),
    }
    if split.uv is not None:
        # The origin of glTF's texture coordinates is the upper left corner.
        flipped = np.stack([split.uv[:, 0], 1 - split.uv[:, 1]], axis=1)
        attributes["TEXCOORD_0"] = buffer.add(flipped.astype(np.float32), _VERTICES)
    targets = []
    for move in morphed.moves:
        normals = unit_normals(part.vertices + move, part.faces)[split.vertex]
        targets.append(
            {
                "POSITION": buffer.add(move[split.vertex].astype(np.float32), _VERTICES, bounds=True),
                "NORMAL": buffer.add((normals - split.normals).astype(np.float32), _VERTICES),
            }
        )
    return {
        "attributes": attributes,
        "indices": buffer.add(split.faces.astype(np.uint32).ravel(), _INDICES),
        "material": number,
        "targets": targets,
    }


def _material(part: Part) -> dict[str, Any]:
    return {
        "name": part.name,
        "doubleSided": part.material.double_sided,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*(float(linear_light(c)) for c in part.material.color), 1.0],
            "metallicFactor": 0.0,
            "roughnessFactor": part.material.roughness,
        },
    }
