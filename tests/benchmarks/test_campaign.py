"""What the campaign goes by: its cases repeat, and its look inside the body is right."""

import numpy as np

from benchmarks.campaign import inside_body, random_case
from tests.flat_model import flat_model
from tests.physics.round_body import RADIUS, make_ball
from tryon_jax.wear.session import Session


def test_winding_numbers_tell_inside_from_outside() -> None:
    ball = make_ball(3)
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(50, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    skin, faces = np.asarray(ball.v_template), np.asarray(ball.faces)
    for share, wanted in ((0.97, True), (1.03, False)):
        assert (inside_body(share * RADIUS * ways, skin, faces, near=0.1) == wanted).all()


def test_a_case_is_the_same_however_many_there_are() -> None:
    session = Session(flat_model())
    first = random_case(session, 0, 5, 4)
    assert first == random_case(session, 0, 5, 4)
    assert first["design"] == random_case(session, 0, 6, 4)["design"]
    assert first["betas"] != random_case(session, 0, 6, 4)["betas"]
    assert np.hypot(*np.array(first["betas"]) / [3.0, 2.0]) <= 1.0
