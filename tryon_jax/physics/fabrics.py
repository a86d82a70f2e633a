"""Fabrics: density, data-driven stretch and bending stiffness, friction and thickness.

The ten embedded fabrics are the measurements of Wang, O'Brien and Ramamoorthi (SIGGRAPH 2011). A user's own fabric is
a TOML file of the same form.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice, check_file, check_finite, check_range
from tryon_jax.types import ArrayLike, pytree, static

GRID = 30
"""Nodes of the stiffness table per strain axis."""
GRID_LOW = -0.25
"""Smallest normal Green strain of the table; nodes are 1/GRID apart."""
KNOWN_KEYS = ("composition", "density", "stretching", "bending", "friction", "thickness")


@pytree
class Fabric:
    """Material of a cloth."""

    density: Float[ArrayLike, ""]
    """Mass per area, kg/m²."""
    stretch_table: Float[ArrayLike, "30 30 30 4"]
    """Stiffness (warp, coupling, weft, shear), N/m, over Green strain (G00, G11, |G01|): G00 and G11 = −0.25 + i/30,
    |G01| = k/30; see `stretch_table`."""
    bending: Float[ArrayLike, "3 5"]
    """Bending stiffness, N·m: rows hinge direction 0, 45, 90° from the warp, columns α = 0, 5, 10, 15, 20 1/m."""
    friction: Float[ArrayLike, ""]
    """Coulomb coefficient between cloth and body."""
    thickness: Float[ArrayLike, ""]
    """Distance from the skin at which contact begins, metres."""
    name: str = static(default="fabric")

    @property
    def unnamed(self) -> "Fabric":
        """The same cloth for compiled code, which would be compiled anew for every name."""
        return replace(self, name="fabric")


def stretch_table(stretching: Float[np.ndarray, "6 4"]) -> Float[np.ndarray, "30 30 30 4"]:
    """Tabulate stretch stiffness over Green strain, as Narain et al. 2012 do with the data of Wang et al. 2011.

    At each node the largest principal stretch s and its angle from the warp choose between the row of zero strain
    (s ≤ 1) and the rows of strain 1/6 (s ≥ 7/6), linearly in s and in the angle; values are doubled and clipped at 0.
    """
    normal = GRID_LOW + np.arange(GRID) / GRID
    shear = np.arange(GRID) / GRID
    g00, g11, g01 = np.meshgrid(normal, normal, shear, indexing="ij")
    c00, c11, c01 = 2 * g00 + 1, 2 * g11 + 1, 2 * g01
    half_difference = 0.5 * (c00 - c11)
    radius = np.hypot(half_difference, c01)
    stretch = np.sqrt(np.maximum(0.5 * (c00 + c11) + radius, 0.0))
    angle = 0.5 * np.abs(np.arctan2(c01, half_difference))
    position = np.clip(angle * 8 / np.pi, 0, 4)
    row = np.minimum(position.astype(int), 3)
    fraction = (position - row)[..., None]
    strained = (1 - fraction) * stretching[1 + row] + fraction * stretching[2 + row]
    weight = np.clip(6 * (stretch - 1), 0, 1)[..., None]
    return 2 * np.maximum((1 - weight) * stretching[0] + weight * strained, 0.0)


def fabric_names() -> tuple[str, ...]:
    """Names of the embedded fabrics."""
    return tuple(sorted(_embedded()))


def load_fabric(name_or_path: str | Path) -> Fabric:
    """An embedded fabric by name, or the only fabric of a TOML file (a path ending in `.toml`).

    Raises:
        ValueError: unknown name, missing or unknown entry, negative or non-finite number, wrong table size.
        FileNotFoundError: no such file.
    """
    text = str(name_or_path)
    if not is_fabric_file(text):
        return _make_fabric(text, _embedded_numbers(check_choice("fabric", text, fabric_names())))
    path = check_file("fabric file", text)
    try:
        tables = tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"fabric file {str(path)!r} is not valid TOML: {error}") from None
    if len(tables) != 1 or not isinstance(next(iter(tables.values())), dict):
        raise ValueError(f"fabric file {str(path)!r} must hold exactly one [fabric-name] table, found {len(tables)}")
    name, table = next(iter(tables.items()))
    return _make_fabric(name, _numbers(name, table))


def is_fabric_file(name: str) -> bool:
    """Whether this is the path of a fabric file and no name."""
    return name.endswith(".toml")


def known_fabric(name: str) -> Fabric | None:
    """The embedded fabric of that name or the fabric of a file; None where networks were trained on another one."""
    return load_fabric(name) if is_fabric_file(name) or name in _embedded() else None


@cache
def _embedded_numbers(name: str) -> dict[str, Any]:
    return _numbers(name, _embedded()[name])


@cache
def _embedded() -> dict[str, Any]:
    return tomllib.loads(resources.files("tryon_jax").joinpath("data/fabrics.toml").read_text())


def _make_fabric(name: str, numbers: Mapping[str, Any]) -> Fabric:
    return Fabric(**{key: jnp.asarray(value) for key, value in numbers.items()}, name=name)


def _numbers(name: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """What a table of a fabric file says, checked."""
    for key in table:
        check_choice(f"entry of fabric {name!r}", key, KNOWN_KEYS)
    for key in ("density", "stretching", "bending"):
        if key not in table:
            raise ValueError(f"fabric {name!r} has no entry {key!r}")
    stretching = _table(name, "stretching", table["stretching"], (6, 4))
    bending = _table(name, "bending", table["bending"], (3, 5))
    # The measured coupling and shear columns dip below zero (fits to noisy data); the axial ones must not.
    if (stretching[0, [0, 2]] < 0).any():
        raise ValueError(f"fabric {name!r}: stretching at zero strain must not be negative, got {stretching[0]}")
    if (bending < 0).any():
        raise ValueError(f"fabric {name!r}: bending must not be negative, got {bending.min():g}")
    return {
        "density": check_range(f"density of fabric {name!r}", table["density"], 0.01, 5.0, "kg/m²"),
        "stretch_table": stretch_table(stretching),
        "bending": bending,
        "friction": check_range(f"friction of fabric {name!r}", table.get("friction", 0.3), 0.0, 2.0),
        "thickness": check_range(f"thickness of fabric {name!r}", table.get("thickness", 0.005), 0.001, 0.02, "m"),
    }


def _table(name: str, key: str, rows: Any, shape: tuple[int, int]) -> np.ndarray:
    try:
        array = check_finite(f"{key} of fabric {name!r}", np.array(rows, float))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{key} of fabric {name!r} must be a {shape[0]} x {shape[1]} table of numbers: {error}"
        ) from None
    if array.shape != shape:
        raise ValueError(f"{key} of fabric {name!r} must be {shape[0]} x {shape[1]}, got {array.shape}")
    return array
