"""The section of the page about what the host does round the networks: records of `first`, `wear` and `picture`."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from measuring.records import table

ABOUT = {
    "first": (
        "The first drape of a new process",
        "From the start of `tryon drape --design dress --betas 1.5 -0.5` to its files (`python -m benchmarks first`), "
        "everything compiled on the way or, with `TRYON_JAX_CACHE`, in an earlier run. The picture has 900 pixels and "
        "three sides.",
    ),
    "wear": (
        "One try-on on the host",
        "Medians of one core (`python -m benchmarks wear`): everything about a try-on but the networks.",
    ),
    "catalogue": (
        "A catalogue",
        "Processor time of one core for each drape of `tryon catalogue` on 64 bodies (`python -m benchmarks "
        "catalogue`), garment and bodies made before, as for all but the first of a block.",
    ),
    "picture": (
        "Pictures",
        "A dressed body drawn from one view and from three (`python -m benchmarks picture`), medians of one core.",
    ),
}
"""Title and text for each benchmark."""


def load_host_records(folder: Path) -> list[dict[str, Any]]:
    """Records of these benchmarks, in their order."""
    paths = [path for name in ABOUT for path in sorted(folder.glob(f"{name}-*.json"))]
    return [json.loads(path.read_text(encoding="utf-8")) for path in paths]


def host_sections(records: Sequence[dict[str, Any]]) -> list[str]:
    """One section for each record.

    Args:
        records: From `load_host_records`.
    """
    parts = []
    for record in records:
        title, about = ABOUT[record["benchmark"]]
        place = record["environment"]
        parts += [f"## {title}", f"{about} {place['device']}, {place['date']}.", table(record["rows"])]
    return parts
