"""What a user asks to be draped: a design, a body shape and a fabric, from options or from a row of a CSV file."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from tryon_jax.body.from_measurements import betas_from_measurements
from tryon_jax.body.measurements import MEASUREMENTS
from tryon_jax.body.shape import full_betas
from tryon_jax.checks import check_choice, check_file
from tryon_jax.garment import Design, DesignSpace
from tryon_jax.types import Body


@dataclass(frozen=True)
class BodyShape:
    """The shape of the body, as betas or as measurements; the mean body when nothing is given."""

    betas: tuple[float, ...] = ()
    """Shape coefficients in standard deviations; those left out are 0."""
    stature: float | None = None
    """Body height, metres."""
    chest: float | None = None
    """Chest (bust) girth of the body, metres."""
    waist: float | None = None
    """Waist girth of the body, metres."""
    hip: float | None = None
    """Hip girth of the body, metres."""
    neck: float | None = None
    """Neck girth, metres."""
    upper_arm: float | None = None
    """Upper-arm girth, metres."""
    arm_length: float | None = None
    """From shoulder over elbow to wrist, metres."""
    inside_leg: float | None = None
    """From crotch to floor, metres."""
    shoulder_width: float | None = None
    """From shoulder point to shoulder point, metres."""

    def measurements(self) -> dict[str, float]:
        """The measurements that are given, metres."""
        given = {name: getattr(self, name) for name in MEASUREMENTS}
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class Cut:
    """The design of the garment."""

    design: str | None = None
    """Preset, such as dress, tshirt, sweater or tank; the mean design when not given."""
    sleeve_length: float | None = None
    """Sleeve length in place of the preset's, metres."""
    garment_chest: float | None = None
    """Circumference of the garment at the underarm in place of the preset's, metres."""
    garment_length: float | None = None
    """Length of the garment in place of the preset's, metres."""
    set: tuple[str, ...] = ()
    """Any design parameters in place of the preset's: NAME=VALUE, metres."""

    def changes(self) -> dict[str, float]:
        """Parameters that differ from the preset's, by their names in the design space."""
        named = {"sleeve_length": self.sleeve_length, "chest": self.garment_chest, "length": self.garment_length}
        changes = {name: value for name, value in named.items() if value is not None}
        for entry in self.set:
            name, equals, text = entry.partition("=")
            if not equals:
                raise ValueError(f"--set takes NAME=VALUE such as length=0.9, got {entry!r}")
            changes[name.strip()] = _number(f"design parameter {name.strip()!r}", text)
        return changes


@dataclass(frozen=True)
class Request:
    """One garment on one body."""

    name: str = "garment"
    cut: Cut = field(default_factory=Cut)
    shape: BodyShape = field(default_factory=BodyShape)
    fabric: str | None = None
    mesh: Path | None = None
    """A mesh of the user's own in place of the cut."""


def resolve_design(space: DesignSpace, cut: Cut) -> Design:
    """The design that is meant; raises `ValueError` for unknown names and values out of range."""
    base = space.mean_design if cut.design is None else space.preset(cut.design)
    changes = cut.changes()
    return space.design(base.label, **(base.as_dict() | changes)) if changes else base


def check_shape(shape: BodyShape) -> None:
    """Raise `ValueError` when both betas and measurements are given."""
    if shape.betas and shape.measurements():
        raise ValueError("give either betas or measurements of the body, not both")


def resolve_betas(body: Body, shape: BodyShape, num_betas: int) -> tuple[np.ndarray, list[str]]:
    """The body shape that is meant.

    Args:
        body: The body.
        shape: What was asked for.
        num_betas: How many betas are known; a shape with these measurements is looked for among those.

    Returns:
        Betas [num_betas], and remarks on how well the measurements are met.

    Raises:
        ValueError: Both betas and measurements, too many betas, or values out of range.
    """
    check_shape(shape)
    asked = shape.measurements()
    if not asked:
        return full_betas(body, np.asarray(shape.betas, np.float32), num_betas), []
    fit = betas_from_measurements(body, asked, num_betas=num_betas)
    remarks = ["betas    " + " ".join(f"{b:+.2f}" for b in np.asarray(fit.betas)) + " from measurements"]
    if fit.outside is not None:
        remarks.append(f"note     {fit.outside}")
    return np.asarray(fit.betas, np.float32), remarks


GARMENT_COLUMNS = ("name", "fabric", "garment", *(f.name for f in fields(Cut)))
"""Columns of a CSV file of garments."""
SIZE_COLUMNS = ("name", *(f.name for f in fields(Cut)))
"""Columns of a table of sizes."""
BODY_COLUMNS = ("name", *(f.name for f in fields(BodyShape)))
"""Columns of a CSV file of bodies."""


def read_requests(path: Path, columns: Sequence[str] = (*GARMENT_COLUMNS, *BODY_COLUMNS[1:])) -> list[Request]:
    """Requests from a CSV file with a header; each column is one of the options, empty cells are not given.

    `name` (the result's file name) is the row's number when it is not given; lists are separated by spaces.

    Args:
        path: The file.
        columns: Those that it may have.

    Raises:
        ValueError: unknown columns, cells that are not numbers, rows with too many cells, or two rows of one name; all
            rows that are wrong are named.
    """
    with check_file("batch file", path).open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream)
        for column in reader.fieldnames or ():
            check_choice(f"column of {path.name}", column, columns)
        rows = list(reader)
    requests, bad = [], []
    for number, row in enumerate(rows, start=1):
        cells = {key: value.strip() for key, value in row.items() if key is not None and value and value.strip()}
        try:
            if None in row:
                raise ValueError(f"it has more cells than the {len(reader.fieldnames or ())} columns")
            requests.append(_request(cells, f"{number:03d}"))
        except ValueError as error:
            bad.append(f"row {number} of {path.name}: {error}")
    if bad:
        raise ValueError("; ".join(bad))
    names = [request.name for request in requests]
    if not names or len(set(names)) != len(names):
        raise ValueError(f"{path.name} must have rows with distinct names, got {names}")
    return requests


def _request(cells: Mapping[str, str], name: str) -> Request:
    name = cells.get("name", name)
    if Path(name).name != name or name == "..":
        raise ValueError(f"name = {name!r} must be a plain file name without a directory")
    cut = Cut(
        design=cells.get("design"),
        sleeve_length=_optional_number(cells, "sleeve_length"),
        garment_chest=_optional_number(cells, "garment_chest"),
        garment_length=_optional_number(cells, "garment_length"),
        set=tuple(cells.get("set", "").split()),
    )
    betas = tuple(_number("betas", text) for text in cells.get("betas", "").split())
    shape = BodyShape(betas, **{key: _number(key, cells[key]) for key in MEASUREMENTS if key in cells})
    mesh = Path(cells["garment"]) if "garment" in cells else None
    if mesh is not None and cut != Cut():
        raise ValueError("give either a design or a garment's mesh, not both")
    return Request(name, cut, shape, cells.get("fabric"), mesh)


def _optional_number(cells: Mapping[str, str], name: str) -> float | None:
    return _number(name, cells[name]) if name in cells else None


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name} must be a number, got {text!r}") from None
