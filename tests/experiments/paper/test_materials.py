"""Two fabrics where the predictions are known: the simulations themselves, then those of the other fabric."""

import numpy as np
import pytest

from experiments.paper import materials
from experiments.shared.record import read_result
from tests.experiments.known_data import FABRICS, TEST


def run_materials(config, monkeypatch):
    sheets = []
    monkeypatch.setattr(materials, "contact_sheet", lambda _path, items, **_: sheets.append(items))
    materials.main(config)
    record = read_result(config.out, "materials")
    assert record is not None
    assert len(sheets[0]) == 8
    return record["results"]


@pytest.mark.slow
def test_a_prediction_is_nearest_to_the_simulation_that_it_is(known, tmp_path, monkeypatch):
    found = run_materials(materials.Config(known.data, known.run, out=tmp_path, refine=1), monkeypatch)
    assert found["garments"] == 1
    assert found["samples"] == TEST.sum()
    distance = np.array(found["distance_mm"])
    np.testing.assert_allclose(np.diag(distance), 0.0, atol=1e-4)
    assert (distance[[0, 1], [1, 0]] > 0.1).all()
    assert found["own_nearer_share"] == [1.0, 1.0]
    assert found["difference_correlation"] == pytest.approx(1.0, abs=1e-5)
    assert found["fabrics_apart_mm"]["predicted"] == pytest.approx(found["fabrics_apart_mm"]["simulated"], rel=1e-4)
    # Each fabric's prediction is as far from the other's simulation as the fabrics are from each other.
    assert distance[0, 1] == pytest.approx(found["fabrics_apart_mm"]["simulated"], rel=1e-4)
    for fabric in FABRICS:
        assert found["folds"][f"predicted {fabric}"] == pytest.approx(found["folds"][f"simulated {fabric}"], rel=1e-3)


@pytest.mark.slow
def test_predictions_of_the_wrong_fabric_are_seen(known, tmp_path, monkeypatch):
    class Swapped(materials.Pipeline):
        def __call__(self, samples, rows, fabrics):
            one, other = super().__call__(samples, rows, fabrics).values()
            return dict(zip(fabrics, (other, one), strict=True))

    monkeypatch.setattr(materials, "Pipeline", Swapped)
    found = run_materials(materials.Config(known.data, known.run, out=tmp_path, refine=1), monkeypatch)
    assert found["own_nearer_share"] == [0.0, 0.0]
    assert found["difference_correlation"] == pytest.approx(-1.0, abs=1e-5)
    assert "not supported" in "\n".join(materials.markdown(found))


@pytest.mark.parametrize(
    ("matrix", "verdict"), [([[3, 4], [5, 2]], ": supported"), ([[3, 4], [1, 2]], ": not supported")]
)
def test_the_verdict_on_materials(matrix, verdict):
    results = {
        "fabrics": ["a", "b"],
        "samples": 4,
        "distance_mm": matrix,
        "own_nearer_share": [1.0, 0.5],
        "fabrics_apart_mm": {"predicted": 1.0, "simulated": 2.0},
        "difference_correlation": 0.5,
        "folds": {
            f"{kind} {fabric}": {"curvature": value, "sharp": 2.0, "concave": 0.5}
            for kind, values in (("predicted", (1.0, 1.1)), ("simulated", (1.0, 1.3)))
            for fabric, value in zip("ab", values, strict=True)
        },
    }
    assert verdict in materials.markdown(results)[-3]
    # A third of the simulated difference on a logarithmic scale.
    assert "not supported (curvature of b ÷ a: 1.10 predicted, 1.30 simulated)" in materials.markdown(results)[-1]
