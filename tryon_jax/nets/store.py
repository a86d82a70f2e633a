"""Parameter stores: a pytree of arrays in one safetensors file, with everything that says what it is for.

No pickle: the file holds arrays named by their place in the tree, and a JSON record. Loading compares
every name, shape and type with what the model expects before anything is returned.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Array
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file, save

from tryon_jax.checks import check_file
from tryon_jax.files.atomic import write_bytes
from tryon_jax.types import Body

Tree = TypeVar("Tree")
SCHEMA = "tryon_jax/parameters/1"
"""Name and version of the file format."""


def hash_arrays(*arrays: Any) -> str:
    """A short fingerprint of shapes, types and bytes."""
    digest = hashlib.sha256()
    for array in arrays:
        array = np.asarray(array, order="C")
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()[:16]


def hash_body(body: Body) -> str:
    """Fingerprint of a body's shape, blend shapes, skinning weights and faces."""
    return hash_arrays(body.v_template, body.shapedirs, body.lbs_weights, body.faces)


def tree_names(tree: Any) -> dict[str, Any]:
    """Leaves of a pytree by dotted path, such as "smooth.encoder.0.1.weight"."""
    named = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        parts = [str(getattr(p, "name", getattr(p, "key", getattr(p, "idx", p)))) for p in path]
        named[".".join(parts)] = leaf
    return named


def save_store(path: str | Path, tree: Any, record: Mapping[str, Any], half: bool = False) -> None:
    """Write the arrays of `tree` and `record` (plain JSON values) to one file, whole or not at all.

    `half` stores the networks' float32 weights as float16; they are read back as float32. Biases, scales and positions
    keep their precision.

    Args:
        path: File to write.
        tree: Arrays.
        record: Plain JSON values.
        half: Store the networks' weights in half precision.
    """
    arrays = {name: np.asarray(leaf, order="C") for name, leaf in tree_names(tree).items()}
    if half:
        arrays |= {name: array.astype(np.float16) for name, array in arrays.items() if _may_be_half(name, array)}
    metadata = {"schema": SCHEMA, "record": json.dumps(record, sort_keys=True)}
    write_bytes(path, save(arrays, metadata=metadata))


def _may_be_half(name: str, array: np.ndarray) -> bool:
    return (
        (".weight" in name or ".components" in name) and array.dtype == np.float32 and bool((np.abs(array) < 6e4).all())
    )


def read_record(path: str | Path) -> dict[str, Any]:
    """The record of a store, without loading its arrays.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no parameter store, or one of another schema.
    """
    file = check_file("parameter store", path)
    try:
        with safe_open(file, framework="numpy") as opened:
            metadata = opened.metadata() or {}
    except SafetensorError as error:
        raise ValueError(f"{str(file)!r} is not a safetensors file, or is damaged: {error}") from error
    if metadata.get("schema") != SCHEMA:
        raise ValueError(f"{str(file)!r} has schema {metadata.get('schema')!r}, this version reads {SCHEMA!r}")
    return json.loads(metadata["record"])


_PRECISIONS = {np.dtype(np.float32), np.dtype(np.float64)}


def load_store(path: str | Path, expected: Mapping[str, Any], any_precision: bool = False) -> dict[str, Array]:
    """The arrays of a store by name, checked against `expected`, which has a shape and a dtype for each name.

    With `any_precision`, arrays in single precision are taken where double is expected and the other way round, and
    stay as they are stored: what JAX expects depends on `jax_enable_x64`, what a file holds does not.

    Args:
        path: File to read.
        expected: Shape and dtype of each array by name.
        any_precision: Whether single and double precision may stand for each other.

    Raises:
        ValueError: an array is missing, superfluous, not finite, or of another shape or type; the first are listed.
    """
    read_record(path)
    try:
        arrays = load_file(check_file("parameter store", path))
    except SafetensorError as error:
        raise ValueError(f"{str(path)!r} is damaged: {error}") from error
    faults = [f"{name} is missing" for name in expected if name not in arrays]
    faults += [f"{name} is not part of the model" for name in arrays if name not in expected]
    for name in expected.keys() & arrays.keys():
        found, wanted = arrays[name], (tuple(expected[name].shape), np.dtype(expected[name].dtype))
        if found.dtype == np.float16 and wanted[1] in _PRECISIONS:
            found = arrays[name] = found.astype(np.float32)
        if any_precision and {found.dtype, wanted[1]} <= _PRECISIONS:
            wanted = (wanted[0], found.dtype)
        if (found.shape, found.dtype) != wanted:
            faults.append(f"{name} is {found.dtype}{list(found.shape)}, not {wanted[1]}{list(wanted[0])}")
        elif not np.isfinite(found).all():
            faults.append(f"{name} holds values that are not finite")
    if faults:
        raise ValueError(f"{str(path)!r} does not fit the model: " + "; ".join(sorted(faults)[:8]))
    # One transfer of all: `jnp.asarray` compiles a program for each shape.
    names = list(expected)
    return dict(zip(names, jax.device_put([arrays[name] for name in names]), strict=True))


def load_tree(path: str | Path, build: Callable[[], Tree]) -> Tree:
    """The arrays of a store in the tree that `build` makes; in whatever precision they are stored.

    Args:
        path: File to read.
        build: Makes such a tree. It is traced for its shapes alone: nothing is initialised.

    Raises:
        ValueError: as in `load_store`.
    """
    built: list[Any] = []

    def expected() -> dict[str, Array]:
        tree = build()
        named = tree_names(tree)
        built.append((jax.tree.structure(tree), list(named)))
        return named

    arrays = load_store(path, jax.eval_shape(expected), any_precision=True)
    structure, names = built[0]
    return jax.tree.unflatten(structure, [arrays[name] for name in names])


def compare_records(found: Mapping[str, Any], wanted: Mapping[str, Any], where: str = "") -> list[str]:
    """Which fields differ between two records, each as "field: found, not wanted".

    Args:
        found: One record.
        wanted: The other one.
        where: Name of the field that both records are the value of.
    """
    faults = []
    for key in wanted:
        if isinstance(wanted[key], Mapping) and isinstance(found.get(key), Mapping):
            faults += compare_records(found[key], wanted[key], f"{where}{key}.")
        elif found.get(key) != wanted[key]:
            faults.append(f"{where}{key}: {found.get(key)!r}, not {wanted[key]!r}")
    return faults


def config_record(config: Any) -> dict[str, Any]:
    """A configuration dataclass as JSON values (tuples become lists)."""
    return json.loads(json.dumps(dataclasses.asdict(config)))
