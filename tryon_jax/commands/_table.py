"""The table of fits that batches and catalogues write: one row for each garment on one body."""

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

from tryon_jax.wear.fit import EASE_AT

TABLE = "fit.csv"
"""Its name, in the folder of the results."""
FAILED = "failed"
"""Outcome of a row that could not be draped; the others are those of the gate."""


def columns(parameters: Sequence[str]) -> list[str]:
    """Columns of the table: the same for every batch of one design space."""
    girths = [
        f"{kind}_{place}"
        for kind in ("body_girth", "garment_girth", "ease", "girth_stretch", "pull")
        for place in EASE_AT
    ]
    return [
        *("name", "outcome", "error", "findings", "garment"),
        *(f"design_{name}" for name in parameters),
        *("betas", "fabric", "vertices"),
        *girths,
        *("too_tight", "tension_95", "tension_max", "vertices_inside", "deepest_inside"),
        *("pushed_inside_before", "pushed_deepest_before", "pushed_largest_move", "order"),
    ]


def flatten(row: Mapping[str, Any]) -> dict[str, Any]:
    """A record of `_report.record` as one row: inner entries are named after the outer one."""
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}_{inner}": number for inner, number in value.items()}
        else:
            flat[key] = value
    return flat


def cell(value: Any) -> str:
    """A value as one cell: lists with spaces or semicolons between, nothing for what is not there."""
    if value is None:
        return ""
    if isinstance(value, list | tuple):
        return "; ".join(value) if value and isinstance(value[0], str) else " ".join(f"{number:g}" for number in value)
    return str(value)


def csv_text(names: Sequence[str], rows: Sequence[Mapping[str, str]]) -> str:
    """Rows as the text of a CSV file with these columns."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
