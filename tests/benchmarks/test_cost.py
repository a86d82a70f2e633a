"""The page on cost: arithmetic on records with known numbers."""

import json

import pytest

from benchmarks import cost
from benchmarks.cost import Config, Rates, catalogue_rows, dataset_rows, growth, hours, rates, size


def cell(subject: str, vertices: int, batch: int, ms: float, config: str = "") -> dict:
    found = {"subject": subject, "config": config, "vertices": vertices, "batch": batch, "precision": "float32"}
    return found | {"ms": ms, "per_second": 1e3 * batch / ms}


RECORD = {
    "benchmark": "compare",
    "environment": {"device": "A processor", "platform": "cpu", "cpu_cores": 4},
    "config": {"at_vertices": 3581, "at_batch": 8},
    "cells": [
        cell("drape", 3581, 1, 20.0, "small"),
        cell("drape", 3581, 8, 80.0, "small"),
        cell("drape", 1414, 8, 10.0, "small"),
        cell("drape", 3581, 8, 800.0, "paper"),
        cell("prepare", 1414, 1, 100.0),
        cell("prepare", 3581, 1, 250.0),
        cell("full equilibrium", 3581, 1, 500.0),
        cell("full equilibrium", 14_324, 1, 4000.0),
        {"subject": "drape", "config": "small", "vertices": 3581, "batch": 64, "precision": "float32", "skipped": "x"},
    ],
}


def test_rates_come_from_the_record():
    rate = rates(RECORD, cpu_price=0.05, gpu_price=2.0)
    assert rate.drapes == pytest.approx(100)
    assert rate.price == pytest.approx(0.2)
    assert rate.prepare == pytest.approx(0.25)
    # Four times the vertices took eight times as long.
    assert rate.equilibrium == pytest.approx((0.5, 1.5))
    assert rates({**RECORD, "cells": []}, 1, 1) is None


def test_growth_through_one_point_is_linear():
    assert growth([(7162, 1.0)]) == pytest.approx((0.5, 1.0))
    assert growth([]) is None


def test_a_catalogue_costs_garments_and_drapes():
    rows = catalogue_rows(Rates("x", "cpu", 0.36, 100.0, 3581, 0.25, None))
    row = next(r for r in rows if r["garments × bodies"] == "100,000 × 1,000")
    assert row["prepare"] == "6.94 h"
    assert row["drape"] == "11.6 days"
    # 25,000 s and 1,000,000 s at 0.0001 euros a second.
    assert row["euros"] == "102"
    assert row["vertices in float32"] == "4.3 TB"


def test_a_dataset_grows_with_vertices():
    rows = dataset_rows(Rates("x", "cpu", 1.0, 1.0, 3581, None, (0.5, 1.5)))
    paper = {r["vertices"]: r for r in rows if r["garments × fabrics × shapes"] == "38 × 2 × 201"}
    assert paper[3581]["simulate"] == hours(38 * 2 * 201 * 0.5)
    assert paper[14_000]["simulate"] == hours(38 * 2 * 201 * 0.5 * (14_000 / 3581) ** 1.5)


def test_numbers_are_readable():
    assert [hours(x) for x in (0.5, 90, 7200, 864_000)] == ["0.5 s", "1.5 min", "2 h", "10 days"]
    assert [size(x) for x in (12, 4.3e7, 4.3e15)] == ["12 B", "43 MB", "4.3 PB"]


def test_the_page_is_written(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(RECORD))
    out = tmp_path / "cost.md"
    cost.main(Config(results=tmp_path, out=out))
    text = out.read_text()
    assert "## A processor" in text
    assert "100,000 × 1,000" in text
    assert "| smooth |" in text
    with pytest.raises(ValueError, match="cpu_price = 0"):
        cost.main(Config(results=tmp_path, out=out, cpu_price=0))
