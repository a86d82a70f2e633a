"""Checks of what users hand in: one clear error that names the thing, its value and what is allowed.

Host side only. Pure JAX functions cannot raise on values, so values are checked where they enter the library
(`prepare`, loaders, the command line) and never inside a jitted function.
"""

import difflib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike


def check_finite(name: str, value: ArrayLike | float | int) -> np.ndarray:
    """Return `value` as an array, or raise `ValueError` naming the first entry that is NaN or infinite."""
    array = np.asarray(value)
    if not np.issubdtype(array.dtype, np.number):
        raise TypeError(f"{name} must be numbers, got an array of {array.dtype}")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        where = tuple(int(i) for i in bad[0])
        raise ValueError(f"{name} must be finite, but entry {where} is {array[where]} ({len(bad)} such entries)")
    return array


def check_range(name: str, value: float | int, low: float | int, high: float | int, unit: str = "") -> float:
    """Return `value` as a float, or raise `ValueError` when it is not in [low, high].

    Lengths in metres (`unit` "m") that look like centimetres, millimetres or inches are told so.

    Args:
        name: What messages call the value.
        value: The number to check.
        low: Smallest value allowed.
        high: Largest value allowed.
        unit: Unit of all three, for messages.

    Raises:
        ValueError: The value is outside of [low, high], or not finite.
    """
    number = float(check_finite(name, value))
    if not low <= number <= high:
        space = f" {unit}" if unit else ""
        hint = _unit_hint(number, low, high) if unit == "m" else ""
        raise ValueError(f"{name} = {number:g}{space} is outside its range {low:g} to {high:g}{space}{hint}")
    return number


def _unit_hint(number: float, low: float, high: float) -> str:
    """What a length in metres was probably meant in."""
    for unit, factor in (("centimetres", 0.01), ("millimetres", 0.001), ("inches", 0.0254)):
        if low <= number * factor <= high:
            return f"; {number:g} looks like {unit}: give {number * factor:.3g}"
    return ""


def check_choice(name: str, value: str, choices: Iterable[str]) -> str:
    """Return `value` when it is one of `choices`, or raise `ValueError` that lists them and the nearest one.

    Args:
        name: What messages call the value.
        value: The name to check.
        choices: What it may be.

    Raises:
        ValueError: It is none of them.
    """
    known = list(choices)
    if value not in known:
        near = difflib.get_close_matches(str(value), known, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise ValueError(f"unknown {name} {value!r}{hint}; known: {', '.join(known)}")
    return value


def check_file(name: str, path: str | Path) -> Path:
    """Return `path` as a `Path` to an existing regular file, or raise `FileNotFoundError`/`IsADirectoryError`."""
    file = Path(path).expanduser()
    if not file.exists():
        raise FileNotFoundError(f"{name}: no file at {str(file)!r}")
    if file.is_dir():
        raise IsADirectoryError(f"{name}: {str(file)!r} is a directory, a file is needed")
    return file
