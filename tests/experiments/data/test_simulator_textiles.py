"""What the drape and cantilever checks say of convergence and order, from coefficients that are known."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from experiments.data.simulator_checks import textiles
from experiments.data.simulator_checks.options import Config

FABRICS = ("gray-interlock", "royal-target", "navy-sparkle-sweat")
COEFFICIENTS = {"gray-interlock": 30.0, "royal-target": 80.0, "navy-sparkle-sweat": 20.0}


@pytest.fixture
def drapes(monkeypatch):
    """Meshes of edges 2, √2 and 1 cm change the coefficient by 4 points, then by 1; pictures are not drawn."""
    names = {float(textiles.sample_fabric(name).density): name for name in FABRICS}

    def coefficient(fabric, edge, settings):
        off = {2.0: 5.0, 1.0: 0.0}.get(round(edge / 0.01, 1), 1.0)
        count = round(1 / edge**2)
        result = SimpleNamespace(
            vertices=np.zeros((count, 3)), steps=1, report=SimpleNamespace(residual=np.float32(1e-3))
        )
        return COEFFICIENTS[names[float(fabric.density)]] + off, result, np.zeros((1, 3), int)

    monkeypatch.setattr(textiles, "drape_coefficient", coefficient)
    monkeypatch.setattr(textiles, "save_drapes", lambda *_: None)


@pytest.mark.usefixtures("drapes")
def test_the_drape_check_says_how_far_the_meshes_are_apart_and_in_which_order_fabrics_come():
    found = textiles.check_drape(Config(fabrics=FABRICS, edge=0.01))
    assert [row["fabric"] for row in found["rows"]] == ["navy-sparkle-sweat", "gray-interlock", "royal-target"]
    assert (
        "changes by 4.0 points on average and 4.0 at most, then 1.0 points on average and 1.0 at most" in found["note"]
    )
    assert set(found["rank_by_mesh"].values()) == {1.0}
    assert -1.0 <= found["rank_by_table"]["at its end"] <= 1.0


def test_a_strip_bends_by_the_row_of_its_direction():
    """Twenty times as stiff in one row of the table: the strip along that direction hardly hangs, the other does."""
    with jax.enable_x64(True):
        for stiff, row in textiles.ROWS.items():
            fabric = textiles.linear_fabric(warp=200.0, shear=80.0, bending=1e-5, density=0.2)
            fabric = replace(fabric, bending=fabric.bending.at[row].set(2e-4))
            angles = {label: textiles._overhang_angle(fabric, 0.06, label, columns=8) for label in textiles.ROWS}
            assert min(angles, key=angles.__getitem__) == stiff
            assert angles[stiff] < 0.7 * max(angles.values())
