"""The page on cost: arithmetic on records with known numbers."""

import json

import pytest

from benchmarks import cost
from benchmarks.catalogue import VARIANTS
from benchmarks.cost import (
    CatalogueRates,
    Config,
    Rates,
    catalogue_rows,
    dataset_rows,
    growth,
    hours,
    load_catalogues,
    rates,
    size,
)


def cell(subject: str, vertices: int, batch: int, ms: float, config: str = "") -> dict:
    found = {"subject": subject, "config": config, "vertices": vertices, "batch": batch, "precision": "float32"}
    return found | {"ms": ms, "per_second": 1e3 * batch / ms}


RECORD = {
    "benchmark": "compare",
    "environment": {"device": "A processor", "platform": "cpu", "cpu_cores": 4},
    "cells": [
        cell("full equilibrium", 3581, 1, 500.0),
        cell("full equilibrium", 14_324, 1, 4000.0),
        {"subject": "full equilibrium", "vertices": 3581, "batch": 64, "precision": "float32", "skipped": "x"},
    ],
}
GUARANTEED, ALONE = (f"{variant}, ms a drape" for variant in VARIANTS)
ROW = {"prepare, ms": 100.0, GUARANTEED: 30.0, ALONE: 1.0, "file, bytes a drape": 2e4}
CATALOGUE = {
    "benchmark": "catalogue",
    "environment": {"device": "A processor"},
    "rows": [ROW, ROW | {GUARANTEED: 50.0, ALONE: 3.0}],
}
CORE = CatalogueRates(prepare=0.1, drape=0.04, alone=0.002, file=2e4)


def test_rates_come_from_the_records(tmp_path):
    (tmp_path / "catalogue-a-processor.json").write_text(json.dumps(CATALOGUE))
    catalogues = load_catalogues(tmp_path)
    assert catalogues == {"A processor": CORE}
    rate = rates(RECORD, catalogues, cpu_price=0.05, gpu_price=2.0)
    assert rate.price == pytest.approx(0.2)
    assert rate.catalogue == CORE
    # Four times the vertices took eight times as long.
    assert rate.equilibrium == pytest.approx((0.5, 1.5))
    assert rates({**RECORD, "cells": []}, {}, 1, 1) is None


def test_growth_through_one_point_is_linear():
    assert growth([(7162, 1.0)]) == pytest.approx((0.5, 1.0))
    assert growth([]) is None


def test_a_catalogue_costs_blocks_and_drapes():
    rows = catalogue_rows(Rates("x", "cpu", 2, 0.36, CORE, None))
    row = next(r for r in rows if r["garments × bodies"] == "1,000 × 1,000")
    # Sixteen blocks of a thousand garments at 0.1 s on two cores; then 40 ms, or 2, for each of a million drapes.
    assert row["prepare"] == "13.3 min"
    assert row["in all"] == hours(800 + 20_000)
    assert row["in all, draped alone"] == hours(800 + 1_000)
    assert row["euros"] == "2.08"
    assert row["files"] == "20 GB"


def test_a_dataset_grows_with_vertices():
    rows = dataset_rows(Rates("x", "cpu", 1, 1.0, None, (0.5, 1.5)))
    paper = {r["vertices"]: r for r in rows if r["garments × fabrics × shapes"] == "38 × 2 × 201"}
    assert paper[3581]["simulate"] == hours(38 * 2 * 201 * 0.5)
    assert paper[14_000]["simulate"] == hours(38 * 2 * 201 * 0.5 * (14_000 / 3581) ** 1.5)


def test_numbers_are_readable():
    assert [hours(x) for x in (0.5, 90, 7200, 864_000)] == ["0.5 s", "1.5 min", "2 h", "10 days"]
    assert [size(x) for x in (12, 4.3e7, 4.3e15)] == ["12 B", "43 MB", "4.3 PB"]


def test_the_page_is_written(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(RECORD))
    cost.main(Config(results=tmp_path, out=tmp_path / "without.md"))
    assert "Not measured here" in (tmp_path / "without.md").read_text()
    (tmp_path / "catalogue-a-processor.json").write_text(json.dumps(CATALOGUE))
    out = tmp_path / "cost.md"
    cost.main(Config(results=tmp_path, out=out))
    text = out.read_text()
    assert "## A processor" in text
    assert "100,000 × 1,000" in text
    assert "| smooth |" in text
    with pytest.raises(ValueError, match="cpu_price = 0"):
        cost.main(Config(results=tmp_path, out=out, cpu_price=0))
