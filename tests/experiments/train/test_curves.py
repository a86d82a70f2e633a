"""The picture of a training curve."""

import pytest

from experiments.train.curves import draw_curve


def test_a_curve_becomes_a_picture(tmp_path):
    pytest.importorskip("matplotlib")
    (tmp_path / "curve.csv").write_text("step,loss,validation,seconds\n10,0.5,7.0,1.0\n20,0.1,0.0,2.0\n")
    draw_curve(tmp_path, "validation error, mm")
    assert (tmp_path / "curve.png").read_bytes()[:4] == b"\x89PNG"
    assert [path.name for path in tmp_path.glob("*.png")] == ["curve.png"]
