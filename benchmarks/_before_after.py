"""Two records of one benchmark line by line, before a change and after it, so that a slowdown is seen."""

import json
import re
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks._platforms import key
from measuring.records import table

MACHINE = ("device", "platform", "cpu", "cpu_cores")
"""What has to be equal for two times to say anything about the code."""
NOTED = ("python", "jax", "jaxlib", "numpy", "scipy", "xla_flags")
"""What may explain a difference."""
NOTICED = 1.1
"""Ratio from where a line without quartiles counts as slower; its inverse as faster."""
# "wall, ms", "s per shape", "median_s"; not "drapes/s", which is no time.
_TIME = re.compile(r"(?:^|[ ,_])(?:µs|ms|s|min|h)(?=$|[ ,)])")


@dataclass(frozen=True)
class Time:
    """One measured time."""

    value: float
    lower: float | None = None
    """Quartiles, where they were kept."""
    upper: float | None = None


Lines = dict[tuple[str, ...], Time]
"""Times by what was timed, in words."""


def read_record(path: Path) -> dict[str, Any]:
    """A record of any benchmark.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no record.
    """
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{str(path)!r} is no record of a benchmark: {error}") from None
    if not isinstance(record, dict) or not {"benchmark", "environment"} <= set(record):
        raise ValueError(f"{str(path)!r} is no record of a benchmark: it has no 'benchmark' and 'environment'")
    return record


def times(record: Mapping[str, Any]) -> Lines:
    """Every time of a record."""
    found: Lines = {}
    for cell in record.get("cells", ()):
        if "ms" in cell:
            name = tuple(str(part) for part in key(cell))
            found[(*name, "ms")] = Time(cell["ms"], cell.get("lower_ms"), cell.get("upper_ms"))
    for row in record.get("rows", ()):
        # Names and whole numbers say what was measured, the rest is what came out.
        name = tuple(f"{k} {v}" for k, v in row.items() if isinstance(v, str | int))
        for column, value in row.items():
            if isinstance(value, Mapping) and "median" in value:
                low, high = value.get("lower_quartile"), value.get("upper_quartile")
                found[(*name, f"{column}, s")] = Time(value["median"], low, high)
            elif isinstance(value, float) and _TIME.search(column):
                found[(*name, column)] = Time(value)
    return found


def compared(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """What became of each time, the slowest first.

    Raises:
        ValueError: the records are of two benchmarks, or have no line in common.
    """
    if before["benchmark"] != after["benchmark"]:
        raise ValueError(f"records of two benchmarks: {before['benchmark']!r} and {after['benchmark']!r}")
    old, new = times(before), times(after)
    both = [name for name in old if name in new and old[name].value > 0]
    if not both:
        raise ValueError("the two records have no measured line in common")
    ratios = {name: new[name].value / old[name].value for name in both}
    rows = [
        {
            "line": ", ".join(part for part in name[:-1] if part),
            "measured": name[-1],
            "before": old[name].value,
            "after": new[name].value,
            "ratio": f"{ratios[name]:.2f}",
            "": _word(old[name], new[name]),
        }
        for name in sorted(both, key=lambda name: -ratios[name])
    ]
    words = [row[""] for row in rows]
    summary = (
        f"{len(rows)} lines: {words.count('slower')} slower, {words.count('faster')} faster, "
        f"median ratio {statistics.median(ratios.values()):.2f} (more than 1 is slower than before)."
    )
    alone = [f"{len(a.keys() - b.keys())} only {when}" for a, b, when in ((old, new, "before"), (new, old, "after"))]
    return "\n\n".join([*_remarks(before["environment"], after["environment"]), table(rows), summary, *_some(alone)])


def _word(before: Time, after: Time) -> str:
    """Whether a difference is more than chance: quartiles apart, or a tenth where there are none."""
    if before.upper is not None and before.lower is not None and after.lower is not None and after.upper is not None:
        slower, faster = after.lower > before.upper, after.upper < before.lower
    else:
        slower, faster = after.value > NOTICED * before.value, after.value * NOTICED < before.value
    return "slower" if slower else "faster" if faster else ""


def _remarks(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    def differences(names: tuple[str, ...]) -> str:
        pairs = [(name, before.get(name), after.get(name)) for name in names]
        return ", ".join(f"{name} {old} and {new}" for name, old, new in pairs if old != new)

    remarks = [f"Before: {_when(before)}. After: {_when(after)}."]
    if machine := differences(MACHINE):
        remarks.append(f"DIFFERENT MACHINES ({machine}): the ratios say nothing about the code.")
    if versions := differences(NOTED):
        remarks.append(f"Other versions or flags: {versions}.")
    loads = [found["load_average"][0] for found in (before, after) if "load_average" in found]
    cores = before.get("cpu_cores") or 1
    if any(load > cores for load in loads):
        remarks.append(
            f"Load {' and '.join(f'{load:g}' for load in loads)} on {cores} cores: other work disturbed them."
        )
    return remarks


def _when(found: Mapping[str, Any]) -> str:
    commit = f", commit {found['commit'][:12]}" if "commit" in found else ""
    changed = "" if found.get("clean", True) else " with changes"
    return f"{found.get('date', 'no date')}{commit}{changed}"


def _some(alone: list[str]) -> list[str]:
    some = [text for text in alone if not text.startswith("0 ")]
    return [f"Lines of one record alone: {', '.join(some)}."] if some else []
