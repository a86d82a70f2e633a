from dataclasses import replace

import numpy as np
import pytest
from flat_model import flat_model

from tryon_jax.viewer.simulation import Simulation
from tryon_jax.viewer.wardrobe import Wardrobe


@pytest.fixture(scope="module")
def wardrobe():
    return Wardrobe(flat_model(target_area=1.5e-3))


@pytest.mark.slow
def test_a_simulation_tells_its_progress_and_ends_on_the_body_that_was_asked_for(wardrobe):
    look = wardrobe.look(replace(wardrobe.start(), betas=(0.5, 0.0)))
    shares, shapes, words = [], [], []

    def step(share, surface):
        shares.append(share)
        shapes.append(surface.vertices)

    simulation = Simulation(wardrobe.body, look, step, words.append)
    simulation.join(400)
    assert not simulation.running
    assert len(words) == 1
    assert words[0].startswith("simulated in")
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert np.isfinite(shapes[-1]).all()
    # The flat panels have become a garment: the cloth hangs before and behind the body.
    assert np.ptp(shapes[-1][:, 2]) > 0.2
    finished = wardrobe.finish(
        replace(look, layers=look.layers | {"drape": replace(look.layers["drape"], vertices=shapes[-1])})
    )
    assert finished.pushed.inside_before < 0.02


def test_what_goes_wrong_is_said(wardrobe):
    look = wardrobe.look(wardrobe.start())
    words = []
    broken = replace(look, wish=replace(look.wish, fabric="silk"))
    Simulation(wardrobe.body, broken, lambda *_: None, words.append).join(60)
    assert words[0].startswith("the simulation failed")
    assert "silk" in words[0]
