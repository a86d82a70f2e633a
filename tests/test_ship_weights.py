"""What is shipped beside the weights: fewer digits, and what the simulator says of stretched edges."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import tryon_jax as tj
from tests.experiments.known_data import known_model
from tools import ship_weights
from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.tryon import init_model
from tryon_jax.wear.dressed import DressedBody


def test_few_digits_are_kept_of_what_starts_from_kriged_drapes() -> None:
    plain = known_model()
    config = replace(plain.config, kriging=KrigingConfig(designs=6, shapes=5, functions=20, components=4))
    model = init_model(jax.random.key(0), config, body=plain.body)
    smaller = ship_weights.fewer_digits(model)
    assert smaller.smooth is model.smooth
    for fabric in model.kriging:
        before, after = (jax.tree.leaves(m.fine[fabric].net) for m in (model, smaller))
        for one, other in zip(before, after, strict=True):
            np.testing.assert_allclose(other, one, rtol=2.0**-ship_weights.DIGITS)
            mantissa = np.frexp(other)[0] * 2**ship_weights.DIGITS
            np.testing.assert_array_equal(mantissa, np.round(mantissa))


@pytest.mark.slow
def test_the_simulator_says_how_far_the_body_stretches_a_garment(monkeypatch: pytest.MonkeyPatch) -> None:
    session = tj.Session(tj.load_pretrained())
    case = ship_weights.Case(tj.load_design_space().preset("tank"), 0, session.fabrics[0], (0.0, 0.0))
    found = ship_weights.simulated_strain(session, case)
    assert found is not None
    assert 0.1 < found < 0.8

    def without_rest(*_: object, **__: object) -> DressedBody:
        raise ValueError

    monkeypatch.setattr(session, "simulate", without_rest)
    assert ship_weights.simulated_strain(session, case) is None
