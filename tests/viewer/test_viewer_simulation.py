from dataclasses import replace

import numpy as np
import pytest

from tests.flat_model import flat_model
from tryon_jax.viewer.page_model import PageModel
from tryon_jax.viewer.simulation import Simulation
from tryon_jax.wear.simulate import Simulated, Simulator


@pytest.fixture(scope="module")
def page():
    return PageModel(flat_model(target_area=1.5e-3))


@pytest.mark.slow
def test_a_simulation_tells_its_progress_and_ends_on_the_body_that_was_asked_for(page):
    result = page.compute(replace(page.start(), betas=(0.5, 0.0)))
    shares, shapes, words = [], [], []

    def step(share, mesh, _):
        shares.append(share)
        shapes.append(mesh.vertices)

    simulation = Simulation(page.session, result, step, words.append, "dress")
    simulation.join(400)
    assert not simulation.running
    assert len(words) == 1
    assert words[0].startswith("simulated in")
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert np.isfinite(shapes[-1]).all()
    # The flat panels have become a garment: the cloth hangs before and behind the body.
    assert np.ptp(shapes[-1][:, 2]) > 0.2
    finished = page.finish(replace(result, dressed=replace(result.dressed, vertices=shapes[-1])))
    assert finished.dressed.pushed.inside_before < 0.02


def test_what_goes_wrong_is_said(page):
    result = page.compute(page.start())
    words = []
    broken = replace(result, dressed=replace(result.dressed, fabric="silk"))
    Simulation(page.session, broken, lambda *_: None, words.append, "dress").join(60)
    assert words[0].startswith("the simulation failed")
    assert "silk" in words[0]


@pytest.mark.slow
def test_a_drape_is_refined_or_left_when_it_is_cancelled(page):
    result = page.compute(page.start())
    shares, words = [], []
    refining = Simulation(page.session, result, lambda share, *_: shares.append(share), words.append, "refine")
    refining.cancel()
    refining.join(400)
    assert words == ["cancelled"]
    shapes = []

    def step(share, mesh, _):
        shares.append(share)
        shapes.append(mesh.vertices)

    Simulation(page.session, result, step, words.append, "refine").join(400)
    assert words[1].startswith("refined in")
    assert shares[-1] == 1.0
    # The flat panels have fallen onto the body.
    assert np.linalg.norm(shapes[-1] - result.dressed.vertices, axis=1).mean() > 0.01


def test_arms_come_down_with_the_body_that_is_shown(page, monkeypatch):
    result = page.compute(page.start())

    def lower(_, vertices, *more):
        for k in range(1, 7):
            more[-1](7.5 * k, 0.005, vertices)
        return Simulated(vertices, 0.005, 0.01, 60, np.zeros(len(vertices)))

    monkeypatch.setattr(Simulator, "lower_arms", lower)
    monkeypatch.setattr(page.session, "push_out", lambda dressed, **_: dressed)
    hands, words = [], []

    def step(share, garment, body):
        hands.append(body.vertices[np.abs(result.body("drape").vertices[:, 0]).argmax(), 1])

    Simulation(page.session, result, step, words.append, "arms").join(60)
    assert words[0].startswith("arms 45 degrees lower")
    assert len(hands) == 7
    assert (np.diff(hands[:6]) < -0.03).all()
