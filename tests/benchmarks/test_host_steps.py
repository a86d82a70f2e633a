"""The page shows what the host does round the networks."""

import json
from pathlib import Path

from benchmarks._host_steps import host_sections, load_host_records


def test_records_become_sections_in_order(tmp_path: Path) -> None:
    place = {"device": "a processor", "date": "2026-01-02"}
    for name in ("wear", "picture", "campaign", "first"):
        record = {"benchmark": name, "environment": place, "rows": [{"step": name, "processor, ms": 12.5}]}
        (tmp_path / f"{name}-a-processor.json").write_text(json.dumps(record))
    parts = host_sections(load_host_records(tmp_path))
    assert [part for part in parts if part.startswith("## ")] == [
        "## The first drape of a new process",
        "## One try-on on the host",
        "## Pictures",
    ]
    assert "a processor, 2026-01-02." in parts[4]
    assert "| wear | 12.5 |" in parts[5]


def test_without_records_there_is_no_section(tmp_path: Path) -> None:
    assert host_sections(load_host_records(tmp_path)) == []
