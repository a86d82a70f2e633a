"""Keep results of benchmarks with the hardware and versions they were measured on."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from measuring.records import environment, plain, slug
from measuring.timing import Timing
from tryon_jax.files.atomic import write_text

RESULTS = Path(__file__).parent / "results"
"""Where results are kept, one file for each benchmark and device."""


def write_record(
    name: str, config: Any, rows: Sequence[Mapping[str, Any]], *, folder: Path | None = None, note: str = ""
) -> Path:
    """Write `rows` of results to `<folder>/<name>-<device>.json` and return the path.

    Args:
        name: the benchmark.
        config: its dataclass of options.
        rows: one mapping for each line of its table; `Timing`s become their fields.
        folder: where to, `benchmarks/results` by default.
        note: what a reader has to know to read the numbers.
    """
    surroundings = environment()
    record = {
        "benchmark": name,
        "note": note,
        "environment": surroundings,
        "config": dataclasses.asdict(config),
        "rows": [
            {key: dataclasses.asdict(value) if isinstance(value, Timing) else value for key, value in row.items()}
            for row in rows
        ],
    }
    path = (RESULTS if folder is None else folder) / f"{name}-{slug(surroundings['device'])}.json"
    write_text(path, json.dumps(record, indent=2, default=plain) + "\n")
    return path
