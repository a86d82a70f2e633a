"""The gate: what is fine, what warns and says where, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from wear.foreign_garments import BODY, tshirt

from tryon_jax.contact.push_out import PushedOut
from tryon_jax.wear.fit import pattern_of
from tryon_jax.wear.gate import LIMITS, Refused, Verdict, judge, judge_betas

SHIRT, FACES = tshirt()
UV, FACES_UV = pattern_of(SHIRT, FACES)
SKIN = np.asarray(BODY.v_template, float)
CLEAN = PushedOut(SHIRT, np.full(len(SHIRT), 0.002), 0.02, 0.004, 0.0, 0.0, 0.006, 2)


def verdict(vertices: np.ndarray = SHIRT, **more) -> Verdict:
    return judge(vertices, FACES, UV, FACES_UV, BODY, SKIN, **more)


def test_a_drape_at_its_rest_lengths_is_fine() -> None:
    fine = verdict(pushed=CLEAN, clearance=np.full(len(SHIRT), 0.02))
    assert fine.outcome == "fine"
    assert fine.lines() == []
    fine.check()


@pytest.mark.parametrize(("reach", "outcome"), [(0.004, "fine"), (0.2, "refused")])
def test_a_spike_at_the_collar_is_named(reach: float, outcome: str) -> None:
    spiked = SHIRT.copy()
    spike = int(np.argmin(np.linalg.norm(SHIRT - [0.0, 0.5, 0.1], axis=1)))
    spiked[spike, 2] += reach
    found = verdict(spiked)
    assert found.outcome == outcome
    if outcome == "refused":
        assert "collar" in found.findings[0].text
        with pytest.raises(
            Refused, match=r"shirt is refused: an edge is \d+\.\d\d times its rest length \(chest and collar"
        ):
            found.check("shirt")


def test_an_edge_between_the_limits_warns() -> None:
    found = verdict(SHIRT * [1.0, 1.45, 1.0])
    assert found.findings[0].measure == "edge"
    assert found.outcome == "warning"
    found.check()
    assert found.lines()[0].startswith("warning  an edge is 1.4")


def test_edges_that_are_long_on_the_mean_body_too_are_not_torn() -> None:
    stretched = SHIRT * [1.0, 1.58, 1.0]
    assert verdict(stretched).outcome == "refused"
    assert all(finding.measure != "edge" for finding in verdict(stretched, mean=stretched).findings)


def test_cloth_in_the_body() -> None:
    deep = replace(CLEAN, inside_before=0.6, deepest_before=0.05, largest_move=0.06)
    assert [(f.measure, f.outcome) for f in verdict(pushed=deep).findings] == [
        ("inside", "refused"),
        ("push", "warning"),
    ]
    shallow = replace(CLEAN, inside_before=1.0, deepest_before=0.01)
    assert verdict(pushed=shallow).outcome == "fine"
    left = verdict(pushed=replace(CLEAN, inside=0.01, deepest=0.001))
    assert [(f.measure, f.outcome) for f in left.findings] == [("left inside", "warning")]
    assert verdict(pushed=replace(CLEAN, deepest=0.01)).outcome == "refused"


def test_cloth_that_flies_away_and_numbers_that_are_none() -> None:
    assert verdict(clearance=np.full(len(SHIRT), 0.7)).findings[0].measure == "far"
    lost = SHIRT.copy()
    lost[3] = np.nan
    with pytest.raises(Refused, match="1 vertices are no numbers"):
        verdict(lost).check()


def test_cloth_that_passes_through_itself() -> None:
    crumpled = SHIRT + 0.02 * np.random.default_rng(0).normal(size=SHIRT.shape)
    assert any(finding.measure == "crossing" for finding in verdict(crumpled).findings)


@pytest.mark.parametrize(
    ("betas", "outcome"),
    [([], "fine"), ([3.0, -2.0], "fine"), ([0.0, -2.5], "warning"), ([4.4, 0.0], "warning"), ([3.0, -4.0], "refused")],
)
def test_bodies_beyond_what_was_learned(betas: list[float], outcome: str) -> None:
    found = judge_betas(np.array(betas), (3.0, 2.0))
    assert found.outcome == outcome
    if outcome == "refused":
        with pytest.raises(Refused, match=r"beta 2 = -4, known from -2 to 2"):
            found.check("this body")


def test_every_limit_warns_before_it_refuses_and_says_so() -> None:
    for limit in LIMITS.values():
        assert limit.warn < limit.refuse
        assert "{" in limit.why
