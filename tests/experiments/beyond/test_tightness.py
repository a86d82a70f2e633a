"""Warnings of tightness against the simulation's tension: what is counted, and what is written of it."""

import numpy as np
import pytest

from experiments.beyond.tightness import _key, compare, markdown

PAIRS = [(10.0, 12.0), (50.0, 60.0), (320.0, 250.0), (400.0, 500.0), (280.0, 420.0)]


def test_warnings_are_counted():
    row = compare("denim", PAIRS)
    assert row["drapes"] == 5
    assert (row["too tight in the simulation"], row["of these warned of"], row["warned of others"]) == (2, 1, 1)
    assert row["rank correlation"] == pytest.approx(0.9)
    lines = "\n".join(markdown({"limit": 300.0, "garments": 3, "fabrics": [row]}))
    assert "above 300 N/m" in lines
    assert "| denim | 5 | 0.9 | 2 | 1 | 1 |" in lines


def test_what_does_not_vary_has_no_correlation():
    assert compare("denim", [(0.0, 3.0), (0.0, 5.0), (0.0, 4.0)])["rank correlation"] is None
    assert compare("denim", [])["drapes"] == 0


def test_shapes_are_found_in_either_precision():
    assert _key(np.array([1.2345678, -0.5], np.float32)) == _key((1.23456779, -0.5))
