"""Two records side by side: what became slower comes first, and other machines are named."""

import copy
import json

import pytest

from benchmarks._before_after import compared, read_record, times
from benchmarks.report import Config, main
from tryon_jax.cli import dispatch

MACHINE = {"date": "2026-11-01", "device": "A", "platform": "cpu", "cpu": "A", "cpu_cores": 2, "jax": "0.10.1"}


def cell(subject, ms, spread=0.1, **more):
    name = {"subject": subject, "config": "small", "vertices": 100, "batch": 8, "precision": "float32"}
    return name | {"ms": ms, "lower_ms": ms - spread, "upper_ms": ms + spread} | more


def record(*cells, **environment):
    return {"benchmark": "compare", "environment": MACHINE | environment, "cells": list(cells)}


def test_each_line_is_found_again_and_the_slowest_is_first():
    before = record(cell("drape", 2.0), cell("prepare", 4.0), cell("push-out", 1.0, spread=0.5), cell("gone", 1.0))
    after = record(cell("push-out", 1.4, spread=0.5), cell("prepare", 3.0), cell("drape", 3.0), {"subject": "skipped"})
    text = compared(before, after)
    rows = [[part.strip() for part in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| ")]
    assert rows[1:] == [
        ["drape, small, 100, 8, float32", "ms", "2", "3", "1.50", "slower"],
        ["push-out, small, 100, 8, float32", "ms", "1", "1.4", "1.40", ""],
        ["prepare, small, 100, 8, float32", "ms", "4", "3", "0.75", "faster"],
    ]
    assert "3 lines: 1 slower, 1 faster, median ratio 1.40" in text
    assert "Lines of one record alone: 1 only before." in text
    assert "DIFFERENT MACHINES" not in text


def test_rows_of_other_benchmarks_are_known_by_names_and_whole_numbers():
    timing = {"first": 1.0, "median": 0.002, "lower_quartile": 0.001, "upper_quartile": 0.003, "repeats": 7}
    row = {
        "garment": "dress",
        "views": 3,
        "wall, ms": 20.0,
        "s per shape": 0.5,
        "drapes/s": 9.0,
        "error": 1.0,
        "t": timing,
    }
    before = {"benchmark": "picture", "environment": MACHINE, "rows": [row]}
    name = ("garment dress", "views 3")
    assert set(times(before)) == {(*name, "wall, ms"), (*name, "s per shape"), (*name, "t, s")}
    after = copy.deepcopy(before)
    after["rows"][0] |= {"wall, ms": 21.0, "s per shape": 0.6}
    text = compared(before, after)
    assert "| garment dress, views 3 | s per shape | 0.5 | 0.6 | 1.20 | slower |" in text
    assert "| garment dress, views 3 | wall, ms | 20 | 21 | 1.05 |  |" in text


def test_other_machines_versions_and_loads_are_said():
    before = record(cell("drape", 2.0), commit="a" * 40, clean=False, load_average=[0.1, 0, 0])
    after = record(cell("drape", 2.0), device="B", cpu="B", jax="0.11.2", load_average=[3.5, 0, 0])
    text = compared(before, after)
    assert "DIFFERENT MACHINES (device A and B, cpu A and B): the ratios say nothing about the code." in text
    assert "Other versions or flags: jax 0.10.1 and 0.11.2." in text
    assert "Load 0.1 and 3.5 on 2 cores: other work disturbed them." in text
    assert "Before: 2026-11-01, commit aaaaaaaaaaaa with changes." in text


def test_what_cannot_be_compared_is_refused(tmp_path):
    one = record(cell("drape", 2.0))
    with pytest.raises(ValueError, match="records of two benchmarks: 'compare' and 'picture'"):
        compared(one, one | {"benchmark": "picture"})
    with pytest.raises(ValueError, match="no measured line in common"):
        compared(one, record(cell("prepare", 2.0)))
    path = tmp_path / "x.json"
    for text in ("{", "[]", "{}"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"x\.json' is no record of a benchmark"):
            read_record(path)


def test_the_command_prints_it_and_leaves_the_page_alone(tmp_path, capsys):
    paths = tmp_path / "before.json", tmp_path / "after.json"
    for path, ms in zip(paths, (2.0, 1.0), strict=True):
        path.write_text(json.dumps(record(cell("drape", ms))))
    command = ["report", "--compare", *map(str, paths), "--out", str(tmp_path / "page.md")]
    assert dispatch("python -m benchmarks", "benchmarks", command) == 0
    assert "| 2 | 1 | 0.50 | faster |" in capsys.readouterr().out
    assert not (tmp_path / "page.md").exists()
    main(Config(compare=paths))
    assert "0.50" in capsys.readouterr().out
