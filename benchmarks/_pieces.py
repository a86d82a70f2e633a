"""A comparison in pieces: what a device's record holds already, and whether it may be continued."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

SAME = ("device", "cpu_cores", "python", "tryon_jax", "jax", "jaxlib", "numpy", "scipy")
"""What must not have changed since a record was begun."""
FREE = ("minutes", "out", "resume", "max_call_seconds", "max_gigabytes")
"""Options that may differ from piece to piece."""
_OVER = "minutes were over"
LIMITS = {
    "max_call_seconds": re.compile(r"one call would take about ([\d.]+) s"),
    "max_gigabytes": re.compile(r"it would need about ([\d.]+) GB"),
}
"""The option that lets a skipped cell in, and what is recorded of the cell."""


def cut_off(minutes: float) -> dict[str, str]:
    """What is recorded of a cell that time did not suffice for."""
    return {"skipped": f"the {minutes:g} {_OVER}"}


def too_long(seconds: float) -> dict[str, str]:
    """What is recorded of a cell whose single call takes more than `max_call_seconds`."""
    return {"skipped": f"one call would take about {seconds:.1f} s"}


def too_large(gigabytes: float) -> dict[str, str]:
    """What is recorded of a cell that takes more than `max_gigabytes`."""
    return {"skipped": f"it would need about {gigabytes:.1f} GB"}


def measured(cell: Mapping[str, Any], options: Mapping[str, Any]) -> bool:
    """Whether a recorded cell is settled: timed, or skipped for a reason that neither time nor `options` mend."""
    reason = str(cell.get("skipped", ""))
    needs = {name: pattern.fullmatch(reason) for name, pattern in LIMITS.items()}
    within = any(found and float(found[1]) <= options[name] for name, found in needs.items())
    return not (within or reason.endswith(_OVER))


def read_begun(path: Path, options: Mapping[str, Any], surroundings: Mapping[str, Any]) -> dict[str, Any] | None:
    """The record to be continued, None where there is none yet.

    Args:
        path: of the record.
        options: of this piece.
        surroundings: hardware and versions of now.

    Raises:
        ValueError: hardware, versions or options are other ones than those that it was begun with.
    """
    if not path.exists():
        return None
    record = json.loads(path.read_text(encoding="utf-8"))
    environment, begun = record["environment"], record["config"]
    now = json.loads(json.dumps(dict(options), default=str))
    changes = [(name, environment.get(name), surroundings.get(name)) for name in SAME]
    changes += [(name, begun.get(name), now[name]) for name in now if name not in FREE]
    for name, then, today in changes:
        if then != today:
            raise ValueError(
                f"resume: {str(path)!r} was begun with {name} = {then!r}, now it is {today!r}; leave out --resume"
            )
    return record
