"""Underwear covers what it should, alike on both sides, and no more."""

import numpy as np
import pytest

from tests.physics.round_body import make_ball
from tryon_jax.body import load_body
from tryon_jax.render.mannequin import SKIN, UNDERWEAR, mannequin_colors, underwear


@pytest.mark.parametrize("name", ["female", "male", "neutral"])
def test_briefs_and_band(name: str) -> None:
    body = load_body(name)
    x, y, _ = np.asarray(body.v_template).T
    share = underwear(name)
    assert share.min() == 0.0
    assert share.max() == 1.0
    crotch = np.flatnonzero((np.abs(x) < 0.02) & (y < -0.06) & (y > -0.12))
    assert share[crotch].min() > 0.9
    # Neither arms nor calves nor head.
    assert share[(np.abs(x) > 0.25) | (y < -0.35) | (y > 0.45)].max() == 0.0
    chest = np.flatnonzero((np.abs(y - 0.3) < 0.03) & (np.abs(x) < 0.1))
    assert share[chest].max() == (0.0 if name == "male" else 1.0)
    left, right = share[x > 0.01].sum(), share[x < -0.01].sum()
    assert left == pytest.approx(right, rel=0.02)


def test_colours_of_an_embedded_and_of_another_body() -> None:
    body = load_body("female")
    colors = mannequin_colors(body)
    assert colors.shape == (len(body.v_template), 3)
    np.testing.assert_allclose(
        colors[underwear("female") == 1.0], np.array([UNDERWEAR] * int((underwear("female") == 1).sum()))
    )
    np.testing.assert_allclose(colors[0 if underwear("female")[0] == 0 else -1], SKIN)
    assert mannequin_colors(make_ball()) == SKIN
