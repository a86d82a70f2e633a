"""Checkpoints of a training run: its whole state, in files that are written completely or not at all.

A small state is one file, checkpoint.npz. A larger one is a folder, checkpoint/, of safetensors shards and an index
that is written last: until it is there the one before counts, whose shards are deleted only afterwards.
"""

import hashlib
import json
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from tryon_jax.files.atomic import write_bytes, write_text
from tryon_jax.training.dataset import load_arrays, save_arrays

MAX_BYTES = 15_000_000
"""No file of a checkpoint is larger."""
_HEADER = 200
"""Bytes of a shard's header for each piece, at most."""


def save_checkpoint(
    folder: Path, leaves: Sequence[np.ndarray], progress: dict[str, Any], max_bytes: int = MAX_BYTES
) -> None:
    """Keep `leaves` and `progress` (plain JSON values) in `folder`, in place of what was kept there before.

    Args:
        folder: Where checkpoints are kept.
        leaves: Arrays.
        progress: Plain JSON values.
        max_bytes: Size of a file at most; larger checkpoints are split over several.
    """
    single, index = folder / "checkpoint.npz", folder / "checkpoint" / "index.json"
    if sum(leaf.nbytes for leaf in leaves) <= max_bytes - 100_000 and not index.exists():
        named = {_name(number): leaf for number, leaf in enumerate(leaves)}
        save_arrays(single, named | {"progress": json.dumps(progress)})
        return
    before = json.loads(index.read_text())["shards"] if index.exists() else []
    used = {shard["file"] for shard in before}
    names = (name for number in count() if (name := f"shard-{number:05d}.safetensors") not in used)
    shards = []
    for pieces in _shards(leaves, max_bytes):
        data, name = save(pieces), next(names)
        write_bytes(index.parent / name, data)
        shards.append({"file": name, "sha256": hashlib.sha256(data).hexdigest()})
    shapes = [{"shape": list(leaf.shape), "dtype": leaf.dtype.str} for leaf in leaves]
    write_text(index, json.dumps({"progress": progress, "leaves": shapes, "shards": shards}) + "\n")
    kept = {shard["file"] for shard in shards}
    for path in index.parent.glob("*.safetensors"):
        if path.name not in kept:
            path.unlink()
    single.unlink(missing_ok=True)


def load_checkpoint(folder: Path) -> tuple[list[np.ndarray], dict[str, Any]] | None:
    """Leaves and progress as they were saved, or None where nothing was.

    Raises:
        ValueError: a file is damaged or missing.
    """
    single, index = folder / "checkpoint.npz", folder / "checkpoint" / "index.json"
    if index.exists():
        return _load_shards(index)
    if not single.exists():
        return None
    arrays = load_arrays(single)
    progress = json.loads(str(arrays.pop("progress", "{}")))
    return [arrays[name] for name in sorted(arrays)], progress


def _name(number: int) -> str:
    return f"leaf{number:05d}"


def _shards(leaves: Sequence[np.ndarray], max_bytes: int) -> list[dict[str, np.ndarray]]:
    """The leaves as flat pieces, "leaf00003.0", "leaf00003.1", …, gathered up to `max_bytes`."""
    shards: list[dict[str, np.ndarray]] = [{}]
    room = max_bytes - _HEADER
    for number, leaf in enumerate(leaves):
        flat = np.ascontiguousarray(leaf).reshape(-1)
        start = 0
        for part in count():
            if room < _HEADER + flat.itemsize:
                shards.append({})
                room = max_bytes - _HEADER
            stop = min(len(flat), start + (room - _HEADER) // flat.itemsize)
            shards[-1][f"{_name(number)}.{part}"] = flat[start:stop]
            room -= _HEADER + (stop - start) * flat.itemsize
            start = stop
            if start == len(flat):
                break
    return shards


def _load_shards(index: Path) -> tuple[list[np.ndarray], dict[str, Any]]:
    try:
        table = json.loads(index.read_text())
        pieces: dict[str, np.ndarray] = {}
        for shard in table["shards"]:
            data = (index.parent / shard["file"]).read_bytes()
            if hashlib.sha256(data).hexdigest() != shard["sha256"]:
                raise ValueError(f"{shard['file']} is not the file that was written")
            pieces |= load(data)
        leaves = []
        for number, described in enumerate(table["leaves"]):
            parts = [pieces[f"{_name(number)}.{k}"] for k in range(sum(p.startswith(_name(number)) for p in pieces))]
            leaves.append(np.concatenate(parts).astype(described["dtype"], copy=False).reshape(described["shape"]))
        return leaves, table["progress"]
    except (ValueError, KeyError, TypeError, OSError, SafetensorError) as error:
        raise ValueError(f"checkpoint {str(index.parent)!r} is damaged ({error}); delete it to start anew") from None
