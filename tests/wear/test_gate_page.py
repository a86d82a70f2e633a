"""The page about garments tells the limits that are used."""

import re
from pathlib import Path

from tryon_jax.wear.gate import LIMITS

PAGE = Path(__file__).parents[2] / "docs" / "garments.md"


def test_the_table_is_that_of_the_gate() -> None:
    rows = re.findall(r"^\| `([\w ]+)`: .* \| ([\d.]+) \| ([\d.]+) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert {name: (float(warn), float(refuse)) for name, warn, refuse in rows} == {
        name: (limit.warn, limit.refuse) for name, limit in LIMITS.items()
    }
