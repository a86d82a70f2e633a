"""Garments made to measure: what is asked for is met, what cannot be had is told, what is open stays as it was."""

from dataclasses import replace

import numpy as np
import pytest

import tryon_jax as tj
from tests.experiments.tiny_garments import tiny_model
from tryon_jax.wear.sizes import best_size, try_size
from tryon_jax.wear.tailor import FitTarget, sitting, tailor

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(scope="module")
def session():
    model = tiny_model()
    return tj.Session(replace(model, config=replace(model.config, target_area=1.2e-3)), one_size=True)


def test_ease_and_hem_are_met_and_the_sleeves_stay(session):
    target = FitTarget({"chest": 0.10}, 0.70)
    found = tailor(session, target, (), start="tshirt")
    assert abs(found.misses["chest"]) < 0.004
    assert abs(found.misses["hem"]) < 0.002
    assert found.simulated is None
    assert found.rounds > 0
    preset = session.space.preset("tshirt")
    assert found.design["sleeve_length"] == pytest.approx(preset["sleeve_length"], abs=1e-4)
    assert found.design["length"] > preset["length"]
    # The answer is measured on the drape that is returned.
    assert found.predicted == sitting(found.dressed, session, target)
    assert not found.at_bounds(session.space)


def test_what_the_pattern_cannot_have_is_told(session):
    found = tailor(session, FitTarget({"chest": 0.8}), (), start="tshirt")
    assert found.at_bounds(session.space) == {"chest": "largest"}
    assert found.misses["chest"] < -0.3
    assert (found.design.values >= session.space.minimum).all()
    assert (found.design.values <= session.space.maximum).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"ease": {"chest": 9.0}}, "ease at the chest"),
        ({"ease": {"knee": 0.1}}, "place of the ease"),
        ({"hem": 60.0}, "height of the hem"),
        ({}, "an ease at chest, waist or hip, or a height of the hem"),
    ],
)
def test_targets_that_make_no_sense_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        FitTarget(**values)


def test_rounds_and_fabrics_are_checked(session):
    with pytest.raises(ValueError, match="rounds"):
        tailor(session, FitTarget(hem=0.7), rounds=0)
    with pytest.raises(ValueError, match="fabric"):
        tailor(session, FitTarget(hem=0.7), fabric="gold")


def test_the_size_nearest_to_the_ease_is_chosen(session):
    target = FitTarget({"chest": 0.12})
    girths = {"S": 0.92, "M": 1.0, "L": 1.08}
    sizes = [
        try_size(session, name, session.space.design(chest=girth, length=0.64), (), target)
        for name, girth in girths.items()
    ]
    eases = [size.got["chest"] for size in sizes]
    assert eases == sorted(eases)
    best = best_size([size for size in sizes if size.wearable])
    if best is not None:
        nearest = min((s for s in sizes if s.wearable), key=lambda s: abs(s.got["chest"] - 0.12))
        assert best is nearest
        assert "nearest" in best.reason(sizes)
    assert all(size.name in size.words() for size in sizes)
    assert np.isfinite([size.miss for size in sizes]).all()


@pytest.mark.slow
def test_a_tape_that_slips_over_the_sleeves_leads_nowhere_else() -> None:
    """On this body the girth of a wide T-shirt falls where the pattern grows: the first step is the wrong way."""
    session = tj.Session(tj.load_pretrained())
    found = tailor(session, FitTarget({"chest": 0.2076}, 0.2806), (-0.51, 1.85), start="tshirt")
    assert abs(found.misses["chest"]) < 0.01
    assert abs(found.misses["hem"]) < 0.005
