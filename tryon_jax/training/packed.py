"""A data set that travels: each garment's drapes in a fabric as modes on a grid, a twentieth of the full set's size.

    ROOT/config.json               as in the full set
    ROOT/packed.json               what was packed, from what, and the errors that were reached
    ROOT/packed/<garment>.npz      mesh, and for each fabric modes, coefficients, body shapes and what the rules say
    ROOT/templates/<design>.npz    as in the full set, in half the digits

The modes are those of a singular value decomposition of the drapes about their mean. Entries are whole multiples of a
step, the largest step that keeps every drape within the error asked for: a mode that moves nothing by half a step is
all zeros and left out, the others take as many bits as they are large. Coefficients are float16.
"""

import io
import json
import lzma
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt, UInt8

from tryon_jax.files.atomic import write_bytes, write_text
from tryon_jax.garment.placement import HEIGHT
from tryon_jax.training.dataset import load_arrays

MAX_ERROR = 3e-4
"""Mean distance over a drape's vertices that packing may move it, metres; no drape of the set is above."""
_FINEST = 2e-6
"""Smallest step of the grid, metres."""
_TRIALS = 14
"""Halvings in search of the step."""


@dataclass(frozen=True, eq=False)
class Drapes:
    """What a data set holds of a garment in one fabric; the mean body comes first."""

    betas: Float[np.ndarray, "S b"]
    vertices: Float[np.ndarray, "S V 3"]
    """Metres; zeros where a sample is neither good nor at rest."""
    test: Bool[np.ndarray, " S"]
    """True for shapes that are only for testing."""
    good: Bool[np.ndarray, " S"]
    """Which samples the rules keep."""
    resting: Bool[np.ndarray, " S"]
    """Which are at rest."""


@dataclass(frozen=True)
class Packing:
    """What packing cost one garment in one fabric."""

    modes: int
    drapes: int
    step: float
    """Of the grid, metres."""
    worst_mm: float
    """Mean distance over the vertices, of the drape that is farthest from what it was."""
    worst_test_mm: float
    """The same among test shapes; 0 where there are none."""
    mean_mm: float
    """Mean over all drapes."""
    largest_mm: float
    """Distance of the vertex that was moved farthest."""


def packed_path(root: Path, garment: str) -> Path:
    """File of a packed garment."""
    return root / "packed" / f"{garment}.npz"


def pack_garment(
    path: Path, mesh: Mapping[str, np.ndarray], fabrics: Mapping[str, Drapes], error: float = MAX_ERROR
) -> dict[str, Packing]:
    """Write a garment with its drapes.

    Args:
        path: File to be written.
        mesh: Arrays as the full set stores them.
        fabrics: Drapes by fabric.
        error: Mean distance over the vertices that no drape may be moved by, metres.

    Returns:
        What was reached in each fabric.
    """
    arrays: dict[str, Any] = dict(_mesh_arrays(mesh))
    found = {}
    for fabric, drapes in fabrics.items():
        packed, found[fabric] = _pack_drapes(drapes, error)
        arrays |= {f"{fabric}:{name}": value for name, value in packed.items()}
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    write_bytes(path, file.getvalue())
    return found


def read_packed_mesh(path: Path) -> dict[str, np.ndarray]:
    """The mesh as the full set stores it; the weights of the template to single precision."""
    arrays = load_arrays(path)
    corners = arrays["vertex_of_uv"].astype(np.int32)
    faces_uv = _unpack_whole(arrays["faces_uv"], np.uint16).reshape(-1, 3).astype(np.int32)
    weights = arrays["template_weights"].astype(np.float64)
    guess = _placed(arrays["uv"], corners).view(np.uint64)
    start = (_unpack_whole(arrays["start"], np.uint64).reshape(-1, 3) ^ guess).view(np.float64)
    return {
        "faces": corners[faces_uv],
        "uv": arrays["uv"],
        "faces_uv": faces_uv,
        "template_vertices": arrays["template_vertices"].astype(np.int32),
        "template_weights": np.concatenate([weights, 1.0 - weights.sum(axis=1, keepdims=True)], axis=1),
        "design": arrays["design"],
        "start": start,
    }


def read_packed_drapes(path: Path, fabric: str) -> Drapes:
    """The drapes in one fabric.

    Raises:
        FileNotFoundError: the garment was not packed in this fabric.
    """
    arrays = load_arrays(path)
    if f"{fabric}:step" not in arrays:
        raise FileNotFoundError(f"{str(path)!r} has no drapes in {fabric}")
    own = {name.split(":")[1]: value for name, value in arrays.items() if name.startswith(f"{fabric}:")}
    kept = own["good"] | own["resting"]
    vertices = np.zeros((len(kept), int(own["vertices"]), 3), np.float32)
    vertices[kept] = _decode(own["modes"], own["coefficients"], float(own["step"])).reshape(-1, *vertices.shape[1:])
    return Drapes(own["betas"], vertices, own["test"], own["good"], own["resting"])


def write_summary(root: Path, source: str, error: float, found: Mapping[str, Mapping[str, Packing]]) -> None:
    """packed.json: from which data set (its checksum), for which error, and what was reached.

    Args:
        root: Folder of the packed set.
        source: Checksum of the full one.
        error: Mean distance that was allowed, metres.
        found: What each garment and fabric takes and how exact it is.
    """
    garments = {name: {fabric: asdict(row) for fabric, row in of.items()} for name, of in found.items()}
    table: dict[str, Any] = {"source": source, "error_mm": 1e3 * error, "garments": garments}
    write_text(root / "packed.json", json.dumps(table, indent=1) + "\n")


def _mesh_arrays(mesh: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Faces as those of the flat pattern and the vertex that each of its corners is sewn to."""
    corners = np.zeros(len(mesh["uv"]), np.int32)
    corners[mesh["faces_uv"]] = mesh["faces"]
    if len(corners) > np.iinfo(np.uint16).max:
        raise ValueError(f"a packed garment has at most 65535 pattern vertices, this one {len(corners)}")
    return {
        "vertex_of_uv": corners.astype(np.uint16),
        "faces_uv": _pack_whole(mesh["faces_uv"].astype(np.uint16)),
        "uv": mesh["uv"],
        # To the last bit: which vertices are pooled together hangs on it.
        "start": _pack_whole(mesh["start"].view(np.uint64) ^ _placed(mesh["uv"], corners).view(np.uint64)),
        "template_vertices": mesh["template_vertices"].astype(np.uint16),
        "template_weights": mesh["template_weights"][:, :2].astype(np.float32),
        "design": mesh["design"],
    }


def _placed(uv: Float[np.ndarray, "U 2"], corners: Int[np.ndarray, " U"]) -> Float[np.ndarray, "V 3"]:
    """Where `placement` puts the vertices, but for the depth: most of these numbers need no space."""
    at = np.zeros(int(corners.max()) + 1, np.int64)
    at[corners[::-1]] = np.arange(len(corners))[::-1]
    return np.stack([uv[at, 0], uv[at, 1] + HEIGHT, np.zeros(len(at))], axis=1)


def _pack_drapes(drapes: Drapes, error: float) -> tuple[dict[str, np.ndarray], Packing]:
    kept = drapes.good | drapes.resting
    real = drapes.vertices[kept].astype(np.float64)
    count, size = len(real), drapes.vertices.shape[1]
    flat = real.reshape(count, 3 * size)
    mean = flat.mean(axis=0) if count else np.zeros(3 * size)
    left, values, right = np.linalg.svd(flat - mean, full_matrices=False)
    # A row of ones and coefficients of unit size: entries of a mode are how far it moves a vertex.
    root = max(count, 1) ** 0.5
    coefficients = np.concatenate([np.ones((count, 1)), left * root], axis=1).astype(np.float16)
    rows = np.concatenate([mean[None], right * values[:, None] / root])

    def trial(step: float) -> tuple[Int[np.ndarray, "K X"], np.ndarray, Float[np.ndarray, "S V"]]:
        whole = np.rint(rows / step).astype(np.int64)
        used = np.any(whole != 0, axis=1)
        used[0] = True
        shown = coefficients[:, used]
        off = (shown.astype(np.float64) @ (whole[used] * step) - flat).reshape(count, size, 3)
        return whole[used], shown, np.linalg.norm(off, axis=2)

    low, high = _FINEST, 4 * error
    for _ in range(_TRIALS):
        middle = (low * high) ** 0.5
        worst = trial(middle)[2].mean(axis=1).max(initial=0.0)
        low, high = (middle, high) if worst <= error else (low, middle)
    whole, shown, off = trial(low)
    of_drapes, test = off.mean(axis=1), drapes.test[kept]
    arrays = {
        "modes": _pack_whole(_zigzag(whole)),
        "coefficients": shown,
        "step": np.float64(low),
        "vertices": np.int64(size),
        "betas": drapes.betas,
        "test": drapes.test,
        "good": drapes.good,
        "resting": drapes.resting,
    }
    reached = Packing(
        modes=len(whole) - 1,
        drapes=count,
        step=low,
        worst_mm=1e3 * float(of_drapes.max(initial=0.0)),
        worst_test_mm=1e3 * float(of_drapes[test].max(initial=0.0)),
        mean_mm=1e3 * float(of_drapes.mean()) if count else 0.0,
        largest_mm=1e3 * float(off.max(initial=0.0)),
    )
    return arrays, reached


def _decode(modes: np.ndarray, coefficients: np.ndarray, step: float) -> Float[np.ndarray, "S X"]:
    folded = _unpack_whole(modes, np.uint32).astype(np.int64)
    whole = (folded >> 1) ^ -(folded & 1)
    rows = whole.reshape(coefficients.shape[1], -1) * step
    return (coefficients.astype(np.float64) @ rows).astype(np.float32)


def _zigzag(whole: Int[np.ndarray, "K X"]) -> UInt[np.ndarray, "K X"]:
    """0, −1, 1, −2, … as 0, 1, 2, 3, …: small numbers of either sign have the same upper bytes."""
    return ((whole << 1) ^ (whole >> 63)).astype(np.uint32)


def _pack_whole(whole: Shaped[np.ndarray, "..."]) -> UInt8[np.ndarray, " n"]:
    """Whole numbers byte by byte, all lowest bytes first, compressed."""
    planes = np.ascontiguousarray(whole.reshape(-1, 1)).view(np.uint8)
    return np.frombuffer(lzma.compress(planes.T.tobytes()), np.uint8)


def _unpack_whole(packed: UInt8[np.ndarray, " n"], dtype: Any) -> UInt[np.ndarray, " m"]:
    planes = np.frombuffer(lzma.decompress(packed.tobytes()), np.uint8).reshape(np.dtype(dtype).itemsize, -1)
    return np.ascontiguousarray(planes.T).view(dtype).reshape(-1)
