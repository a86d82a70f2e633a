"""Bytes are those of the arrays that a model has."""

import jax
import numpy as np
import pytest

from experiments.paper import memory
from experiments.shared.record import read_result
from tests.experiments.known_data import FABRICS
from tryon_jax.nets.config import PAPER, SMALL
from tryon_jax.tryon import prepare


def array_bytes(*trees):
    return sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(trees))


def test_a_stages_bytes_are_those_of_its_network(known):
    model = known.model
    assert memory.stage_bytes(model.config) == array_bytes(model.smooth.net, model.fine[FABRICS[0]].net)


@pytest.mark.usefixtures("unchecked")  # `lower` puts descriptions where weights belong
def test_a_drapes_arguments_are_the_model_and_the_garment(known, tmp_path):
    memory.main(memory.Config(out=tmp_path, run=known.run, designs=("tank",)))
    record = read_result(tmp_path, "memory")
    assert record is not None
    found = record["results"]
    garment = prepare(known.model, "tank")
    (row,) = found["drapes"]
    assert row["vertices"] == garment.num_vertices
    assert row["argument_bytes"] == array_bytes(known.model, garment)
    # 5 inputs, one hidden layer of 806, three coordinates of 17,246 vertices; weights and biases of 4 bytes.
    assert found["weights"]["fully connected"] == 4 * (6 * 806 + 807 * 3 * 17_246)


def test_weights_are_counted():
    # One hidden layer of one neuron: (2 + 1) weights and biases in, (1 + 1) · 3 out.
    assert memory.dense_bytes([2, 1, 3]) == 4 * (3 + 6)
    layers = memory.dense_layers(167.0, 5, 3 * 17_246)
    assert 167.0e6 <= memory.dense_bytes(layers) < 167.5e6
    assert memory.stage_bytes(SMALL) < memory.stage_bytes(PAPER) <= 71e6


def test_memory_states_its_factor():
    results = {
        "weights": {"small": 1e6, "paper": 70e6, "fully connected": 167e6},
        "dense_layers": [5, 806, 51_738],
        "drapes": [],
    }
    lines = "\n".join(memory.markdown(results))
    assert "supported (factor 2.39)" in lines
    assert "not supported" in "\n".join(memory.markdown(results | {"weights": results["weights"] | {"paper": 72e6}}))
