"""Topologies whose error is known: their drapes are the model's predictions, moved by 1 mm and by 2 mm."""

import numpy as np
import pytest

from experiments.paper import new_topologies
from experiments.shared.record import read_result
from tests.experiments.known_data import BETAS, TEST


@pytest.mark.slow
def test_each_topology_is_measured_against_its_own_simulation(known, tmp_path):
    config = new_topologies.Config(known.data, known.run, out=tmp_path, design="tshirt")
    new_topologies.main(config)
    record = read_result(tmp_path, "new_topologies")
    assert record is not None
    found = record["results"]
    by_name = {entry["name"]: entry for entry in found["topologies"]}
    assert {name: entry["split"] for name, entry in by_name.items()} == {"tshirt-0": "training", "tshirt-100": "test"}
    for name, offset in (("tshirt-0", 1.0), ("tshirt-100", 2.0)):
        entry = by_name[name]
        np.testing.assert_allclose(entry["betas"], BETAS[TEST])
        np.testing.assert_allclose(entry["vertex_mm"], offset, atol=1e-3)
        # Surfaces moved along themselves in some places and across in others.
        assert all(0.8 * offset < value <= offset + 1e-3 for value in entry["hausdorff_mm"])
    assert found["ratio"] == pytest.approx(2.0, rel=0.1)
    assert found["simulations_apart_mm"] > 0.0
    assert "not supported" in new_topologies.markdown(found)[-1]


def test_the_verdict_on_topologies_follows_from_the_means():
    def topology(split, value):
        return {"split": split, "hausdorff_mm": [value, value + 2], "vertex_mm": [1.0]}

    found = new_topologies.summarise([topology("training", 9), topology("training", 11), topology("test", 10.5)])
    assert found["ratio"] == pytest.approx(11.5 / 11)
    assert found["unseen"]["topologies"] == 1
    assert new_topologies.summarise([topology("training", 9)])["ratio"] is None


@pytest.mark.parametrize(("value", "verdict"), [(10.2, "supported: unseen"), (12.0, "not supported: unseen")])
def test_the_verdict_on_topologies(value, verdict):
    def entry(split, hausdorff):
        return {"split": split, "hausdorff_mm": [hausdorff], "vertex_mm": [1.0]}

    found = new_topologies.summarise([entry("training", 10.0), entry("test", value)])
    assert verdict in new_topologies.markdown(found)[-1]
