"""A comparison in pieces: what a device's record holds already, and whether it may be continued."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

SAME = ("device", "cpu_cores", "python", "tryon_jax", "jax", "jaxlib", "numpy", "scipy")
"""What must not have changed since a record was begun."""
FREE = ("minutes", "out", "resume")
"""Options that may differ from piece to piece."""
_OVER = "minutes were over"


def cut_off(minutes: float) -> dict[str, str]:
    """What is recorded of a cell that time did not suffice for."""
    return {"skipped": f"the {minutes:g} {_OVER}"}


def measured(cell: Mapping[str, Any]) -> bool:
    """Whether a recorded cell is settled: timed, or skipped for a reason that more time does not mend."""
    return not str(cell.get("skipped", "")).endswith(_OVER)


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
