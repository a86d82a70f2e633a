"""Made to measure: when a fit counts as met, and the table."""

from experiments.beyond.made_to_measure import markdown, met


def case(ease_off, hem_off):
    got = {"chest": None if ease_off is None else 0.1 + ease_off, "hem": 0.7 + hem_off}
    return {
        "asked": {"chest": 0.1, "hem": 0.7},
        "predicted": {"chest": 0.1, "hem": 0.7},
        "refined": None,
        "dressed": got,
        "rounds": 2,
        "seconds": 1.5,
    }


def test_a_fit_is_met_within_a_centimetre_of_ease_and_half_of_hem():
    assert met(case(0.0099, -0.0049))
    assert not met(case(0.011, 0.0))
    assert not met(case(0.0, 0.006))
    assert not met(case(None, 0.0))


def test_table():
    cases = [case(0.002, 0.001), case(-0.02, 0.003), case(None, 0.001)]
    text = "\n".join(markdown({"fabric": "f", "refine": False, "cases": cases}))
    assert "3 random bodies in f that" in text
    assert "| the learned drape, pushed out | 3 of 3 | 0.0 (0.0) | 0.0 (0.0) |" in text
    assert "| the garment dressed anew by the simulator | 1 of 3 | 11.0 (20.0) | 1.0 (3.0) |" in text
