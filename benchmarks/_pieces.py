"""A comparison in pieces: what a device's record holds already, and whether it may be continued."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

SAME = ("device", "cpu_cores", "python", "tryon_jax", "jax", "jaxlib", "numpy", "scipy", "xla_flags")
"""What must not have changed since a record was begun."""
LIMITS = ("max_call_seconds", "max_lanes_seconds", "max_gigabytes")
"""Options that keep cells out; a skipped cell says in `needs` what would let it in."""
FREE = ("minutes", "out", "resume", *LIMITS)
"""Options that may differ from piece to piece."""
_OVER = "minutes were over"
_FAILED = "failed: "
RUNNING = "a run ended while it was measured"
"""What is recorded of a cell while it is measured, and stays where the process is lost."""


def cut_off(minutes: float) -> dict[str, str]:
    """What is recorded of a cell that time did not suffice for."""
    return {"skipped": f"the {minutes:g} {_OVER}"}


def too_long(seconds: float, limit: float) -> dict[str, Any]:
    """What is recorded of a cell whose call takes so long, and the `max_call_seconds` that admits it."""
    return {"skipped": f"one call would take about {seconds:.1f} s", "needs": {"max_call_seconds": limit}}


def too_large(gigabytes: float) -> dict[str, Any]:
    """What is recorded of a cell that takes more than `max_gigabytes`."""
    return {"skipped": f"it would need about {gigabytes:.1f} GB", "needs": {"max_gigabytes": gigabytes}}


def failed(error: Exception) -> dict[str, str]:
    """What is recorded of a cell that was wrong or broke off; `--resume` tries it again."""
    return {"skipped": f"{_FAILED}{str(error).strip().splitlines()[0]}"}


def measured(cell: Mapping[str, Any], options: Mapping[str, Any]) -> bool:
    """Whether a recorded cell is settled: timed, or skipped for a reason that neither time nor `options` mend."""
    if "skipped" not in cell:
        return True
    let_in = any(least <= options[name] for name, least in cell.get("needs", {}).items())
    again = cell["skipped"] == RUNNING or cell["skipped"].endswith(_OVER) or cell["skipped"].startswith(_FAILED)
    return not (let_in or again)


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
