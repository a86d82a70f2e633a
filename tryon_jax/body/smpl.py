"""Files of SMPL (Loper et al. 2015), SMPL-H and SMPL-X as bodies; the user's files stay where they are."""

import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import sparse

from tryon_jax.body.unpickle import read_arrays
from tryon_jax.checks import check_file, check_finite
from tryon_jax.mesh.units import PERSON, UNITS, fitting_units
from tryon_jax.types import Body

SMPL_JOINTS = (
    "pelvis", "L_hip", "R_hip", "spine1", "L_knee", "R_knee",
    "spine2", "L_ankle", "R_ankle", "spine3", "L_foot", "R_foot",
    "neck", "L_collar", "R_collar", "head", "L_shoulder", "R_shoulder",
    "L_elbow", "R_elbow", "L_wrist", "R_wrist",
)  # fmt: skip
"""Names of the 22 joints that SMPL, SMPL-H and SMPL-X share, in their order."""
_FIELDS = ("v_template", "shapedirs", "J_regressor", "weights", "kintree_table", "f")


def load_smpl(path: str | Path, num_betas: int = 10) -> Body:
    """The body in a file of SMPL (`.pkl` or `.npz`), SMPL-H or SMPL-X (`.npz`), with its first `num_betas` betas.

    Pickles, also those of SMPL 1.0 and 1.1 that hold chumpy arrays, are read without running anything in them and
    without chumpy. Pose blend shapes are kept; expressions and hand components are not. The mean body is moved so that
    its pelvis joint is the origin; vertices are otherwise those of the file (y up, float32). Lengths in centimetres or
    another unit are told by the size of a person and brought to metres, with a `UserWarning`.

    Raises `FileNotFoundError`, `IsADirectoryError`, and `ValueError` for a file that is damaged, lacks a field, holds
    arrays that do not fit together or are not numbers, names anything but arrays, is no grown person in any unit, or
    has fewer than `num_betas` betas.
    """
    file = check_file("SMPL file", path)
    suffix = file.suffix.lower()
    if suffix not in (".npz", ".pkl"):
        raise ValueError(f"SMPL file {str(file)!r} must end in .npz or .pkl, {_ending(suffix)}")
    fields = _read_npz(file) if suffix == ".npz" else read_arrays(file)
    missing = [name for name in _FIELDS if name not in fields]
    if missing:
        raise ValueError(f"{str(file)!r} is no SMPL body: it lacks {', '.join(missing)} (it has {sorted(fields)[:12]})")
    return _to_body(file, fields, num_betas)


def _ending(suffix: str) -> str:
    return f"not {suffix!r}" if suffix else "but it has no suffix"


def _read_npz(file: Path) -> dict[str, np.ndarray]:
    wanted = {*_FIELDS, "posedirs"}
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            keys = [key for key in archive.files if key in wanted]
            objects = [key for key in keys if _holds_objects(archive.zip, key)]
            if not objects:
                return {key: archive[key] for key in keys}
    except (zipfile.BadZipFile, EOFError, OSError, KeyError, ValueError) as error:
        # Not NumPy's own words: they advise to unpickle whatever is in the file.
        raise ValueError(f"{str(file)!r} is not a readable .npz of plain arrays (truncated or damaged)") from error
    raise ValueError(f"{str(file)!r}: {_NO_NUMBERS.format(' and '.join(objects))}")


_NO_NUMBERS = (
    "{} holds Python objects and not numbers, as NumPy saves a sparse matrix or a chumpy array; nothing in it was run. "
    "Save it as plain numbers (a sparse matrix by its .toarray()), or give the original .pkl file"
)


def _holds_objects(archive: Any, key: str) -> bool:
    """Whether an array of an .npz archive is one of pickled objects, by its header alone."""
    with archive.open(f"{key}.npy") as stream:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        return read(stream)[2].hasobject


def _numbers(file: Path, fields: Mapping[str, Any], key: str, ndim: int) -> np.ndarray:
    value = fields[key]
    if sparse.issparse(value):
        if int(np.prod(value.shape)) > 10**9:
            raise ValueError(f"{str(file)!r}: {key} of shape {value.shape} is too large to be a body's")
        value = value.toarray()
    if isinstance(value, np.ndarray) and value.dtype == object:
        raise ValueError(f"{str(file)!r}: {_NO_NUMBERS.format(key)}")
    try:
        array = check_finite(f"{str(file)!r}: {key}", value)
    except TypeError as error:
        raise ValueError(str(error)) from error
    if array.ndim != ndim:
        raise ValueError(f"{str(file)!r}: {key} must have {ndim} axes, got shape {array.shape}")
    return array


def _fit(file: Path, name: str, got: tuple[int, ...], needed: tuple[int, ...]) -> None:
    if got != needed:
        raise ValueError(f"{str(file)!r}: {name} must be {needed} to fit the other arrays, got {got}")


def _to_body(file: Path, fields: Mapping[str, Any], num_betas: int) -> Body:
    template = _numbers(file, fields, "v_template", 2).astype(np.float64)
    directions = _numbers(file, fields, "shapedirs", 3).astype(np.float64)
    regressor = _numbers(file, fields, "J_regressor", 2).astype(np.float64)
    weights = _numbers(file, fields, "weights", 2).astype(np.float64)
    tree = _numbers(file, fields, "kintree_table", 2)
    faces = _numbers(file, fields, "f", 2)
    count, joints = len(template), len(regressor)

    _fit(file, "v_template", template.shape, (count, 3))
    _fit(file, "shapedirs", directions.shape[:2], (count, 3))
    _fit(file, "J_regressor", regressor.shape, (joints, count))
    _fit(file, "weights", weights.shape, (count, joints))
    _fit(file, "kintree_table", tree.shape, (2, joints))
    _fit(file, "faces", faces.shape, (len(faces), 3))
    if not 1 <= num_betas <= directions.shape[2]:
        raise ValueError(f"num_betas = {num_betas} is outside 1 to {directions.shape[2]}, the betas in {str(file)!r}")
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= count or (faces != faces.astype(np.int64)).any():
        raise ValueError(
            f"{str(file)!r}: faces must index {count} vertices, but they run from "
            f"{faces.min(initial=0)} to {faces.max(initial=0)}"
        )
    # The root's parent is written as -1 or as 2³² - 1.
    parents = [-1, *(int(parent) for parent in tree[0, 1:])]
    for joint, parent in enumerate(parents[1:], start=1):
        if not 0 <= parent < joint:
            raise ValueError(f"{str(file)!r}: joint {joint} has parent {parent}, which must come before it")
    for name, rows in (("J_regressor", regressor), ("weights", weights)):
        worst = np.abs(rows.sum(axis=1) - 1).max()
        if worst > 1e-2:
            raise ValueError(f"{str(file)!r}: each row of {name} must sum to 1, but one is {worst:.3g} off")

    metres = _metres(file, template, directions)
    template, directions = metres * template, metres * directions
    posedirs = None
    if "posedirs" in fields:
        bends = metres * _numbers(file, fields, "posedirs", 3)
        _fit(file, "posedirs", bends.shape, (count, 3, 9 * (joints - 1)))
        posedirs = jnp.asarray(np.moveaxis(bends, 2, 0), jnp.float32)
    names = [*SMPL_JOINTS, *(("L_hand", "R_hand") if joints == 24 else ())]
    names = names[:joints] + [f"joint_{joint}" for joint in range(len(names), joints)]
    return Body(
        v_template=jnp.asarray(template - regressor[0] @ template, jnp.float32),
        shapedirs=jnp.asarray(directions[..., :num_betas], jnp.float32),
        J_regressor=jnp.asarray(regressor, jnp.float32),
        lbs_weights=jnp.asarray(weights, jnp.float32),
        faces=jnp.asarray(faces.astype(np.int64), jnp.int32),
        posedirs=posedirs,
        parents=tuple(parents),
        joint_names=tuple(names),
        name=file.stem,
    )


_ONE_BETA = (1e-4, 0.5)
"""Farthest that one standard deviation of the first beta moves a vertex, metres: in SMPL's bodies 0.05 to 0.1."""


def _metres(file: Path, template: np.ndarray, directions: np.ndarray) -> float:
    """Metres in the file's unit of length; raises `ValueError` where its size is not a person's in any unit."""
    size = float(np.ptp(template, axis=0).max())
    units = fitting_units(size, *PERSON)
    if not units:
        raise ValueError(
            f"{str(file)!r}: v_template is {size:g} units across, which is no grown person ({PERSON[0]:g} to "
            f"{PERSON[1]:g} m) in {', '.join(UNITS)}"
        )
    metres = UNITS[units[0]]
    reach = metres * float(np.linalg.norm(directions[..., 0], axis=1).max())
    if not _ONE_BETA[0] <= reach <= _ONE_BETA[1]:
        raise ValueError(
            f"{str(file)!r}: v_template is in {units[0]}, and in that unit the first of shapedirs moves vertices by up "
            f"to {reach:.3g} m, outside {_ONE_BETA[0]:g} to {_ONE_BETA[1]:g} m: they are in another unit"
        )
    if metres != 1.0:
        said = f"{str(file)!r} is {size:g} units tall or wide: took lengths as {units[0]} and brought them to metres"
        warnings.warn(said, stacklevel=4)
    return metres
