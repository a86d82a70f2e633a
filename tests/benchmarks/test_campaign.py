"""What the campaign goes by: its cases repeat, it resumes, and its look inside the body is right."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks.campaign import Config, Tally, inside_body, random_case, read_tally, run_case, summary
from benchmarks.record import write_record
from benchmarks.report import campaign_section, load_campaigns
from measuring.records import environment
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
        assert (inside_body(share * RADIUS * ways, skin, faces) == wanted).all()


@pytest.mark.slow
def test_a_case_is_the_same_however_many_there_are() -> None:
    session = Session(flat_model())
    first = random_case(session, 0, 5, 4)
    assert first == random_case(session, 0, 5, 4)
    assert first["design"] == random_case(session, 0, 6, 4)["design"]
    assert first["betas"] != random_case(session, 0, 6, 4)["betas"]
    assert np.hypot(*np.array(first["betas"]) / [3.0, 2.0]) <= 1.0


def test_a_campaign_goes_on_where_its_record_ends(tmp_path: Path) -> None:
    surroundings = environment()
    tally = Tally(50, Counter(fine=48, warning=1), Counter(push=1), 1.3, 0.01, 20.0, [{"fault": "a"}])
    assert read_tally(Config(), tmp_path, surroundings) == Tally()
    write_record("campaign", Config(), [tally.row()], folder=tmp_path)
    assert read_tally(Config(cases=100, resume=True), tmp_path, surroundings) == tally
    with pytest.raises(ValueError, match="begun with seed 0, not 1"):
        read_tally(Config(seed=1), tmp_path, surroundings)
    with pytest.raises(ValueError, match="begun with commit"):
        read_tally(Config(), tmp_path, surroundings | {"commit": "another"})


def test_a_case_that_raises_is_a_fault_and_the_summary_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    session, tally = Session(flat_model()), Tally()
    monkeypatch.setattr(session, "prepare", lambda *_, **__: 1 / 0)
    run_case(session, random_case(session, 0, 0, 4), tally)
    assert tally.faults[0]["fault"] == "ZeroDivisionError: division by zero"
    assert "division by zero" in summary(tally)


def test_the_page_shows_what_came_of_the_cases(tmp_path: Path) -> None:
    assert campaign_section(load_campaigns(tmp_path)) == []
    fault = {"fault": "2 vertices are inside the body", "design": [0.1], "betas": [0.5]}
    tally = Tally(40, Counter(fine=37, refused=2), Counter(), 1.3, 0.012, 20.0, [fault])
    write_record("campaign", Config(), [tally.row()], folder=tmp_path)
    text = "\n".join(campaign_section(load_campaigns(tmp_path)))
    for words in (
        "| 40 |",
        "| 37 | 0 | 2 | 1 | 1.3 | 12 | 0.5 |",
        "- 2 vertices are inside the body: [0.1], betas [0.5]",
    ):
        assert words in text
