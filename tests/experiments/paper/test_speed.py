"""Speed: factors are of medians, nothing is called at rest that is not, distances decide the verdict."""

from experiments.paper.speed import ROWS, draw, markdown


def results(residual=0.009, transfer=20.0):
    seconds = {"drape": 0.01, "fields": 0.001, "fields, batch": 1e-4, "paper form": 0.02, "paper form, batch": 0.005}
    seconds |= {"pushed out": 1.0, "transfer": 1e-4, "simulator": 3.0, "simulator, at once": 1.0}
    assert set(seconds) == set(ROWS)
    garment = {
        "design": "tshirt",
        "vertices": 9,
        "once_seconds": {"dressing": 2.0},
        "rows": {row: {"seconds": s, "quartiles": [s, s], "repeats": 3} for row, s in seconds.items()},
        "distance_mm": {"drape": 5.0, "pushed out": 5.0, "transfer": transfer, "simulator, at once": 1.0},
        "residual": {"simulator": 0.009, "simulator, at once": residual},
        "tolerance": 0.01,
    }
    return {"fabric": "f", "betas": [1.0, 0.0], "batch": 2, "flags": "", "garments": [garment]}


def test_factor_and_verdict(tmp_path):
    text = "\n".join(markdown(results()))
    assert "300 to 300 times faster" in text
    assert "a new body is 20 to 20 times faster than in the paper's form, and 50 to 50 times in a batch of 2" in text
    assert "than the transfer: supported" in text
    assert "not at rest" not in text
    assert "Once for each design: dressing 2.00 s." in text
    draw(tmp_path / "speed.png", results())
    assert (tmp_path / "speed.png").exists()


def test_what_is_not_at_rest_is_told():
    text = "\n".join(markdown(results(residual=0.05, transfer=4.0)))
    assert "residual 0.050: not at rest" in text
    assert "than the transfer: not supported" in text
