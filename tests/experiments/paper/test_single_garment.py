"""The single-garment model on a garment that moves by a known law, and where it may not or cannot follow."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.paper.single_garment import Config, SingleGarment, carried, how, markdown, train_single
from tests.experiments.tiny_garments import FABRIC, stretched, tiny_model
from tryon_jax.garment import load_manifest
from tryon_jax.nets.mlp import MLP
from tryon_jax.training.loop import LoopOptions


@pytest.fixture(scope="module")
def samples():
    return stretched(tiny_model())


def test_it_learns_how_its_garment_moves(samples, tmp_path):
    options = LoopOptions(steps=300, learning_rate=1e-2, evaluate_every=100)
    config = Config(cache=tmp_path, fabric=FABRIC, loop=options, batch=8, wrinkle_hidden=8)
    single = train_single(samples, load_manifest(), config, "toy")
    count = samples.garment.num_vertices
    rows = np.flatnonzero(samples.test)
    error = np.linalg.norm(single(samples.betas[rows]) - samples.drapes[FABRIC][rows, :count], axis=-1)
    assert 1e3 * error.mean() < 1.5
    moved = np.linalg.norm(samples.drapes[FABRIC][rows, :count] - single.rest[None], axis=-1)
    assert error.mean() < 0.2 * moved.mean()


def test_test_garments_are_refused(samples, tmp_path):
    with pytest.raises(PermissionError, match="tshirt-100 is a test garment"):
        train_single(replace(samples, name="tshirt-100"), load_manifest(), Config(cache=tmp_path), "toy")


def test_without_the_drape_on_the_mean_body_there_is_nothing_to_start_from(samples, tmp_path):
    some = replace(samples, good={FABRIC: (samples.betas != 0).any(axis=1)})
    with pytest.raises(ValueError, match=r"tshirt-0 has \d+ good training shapes"):
        train_single(some, load_manifest(), Config(cache=tmp_path), "toy")


def test_elsewhere_each_vertex_moves_as_the_closest_one_does():
    rest = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    # Nothing but the output's bias: the first vertex moves along x, the second along y.
    net = MLP((np.zeros((2, 6), np.float32),), (np.array([1, 0, 0, 0, 1, 0], np.float32),))
    still = MLP((np.zeros((2, 6), np.float32),), (np.zeros(6, np.float32),))
    single = SingleGarment(rest, net, still, (0.01, 1.0))
    other = np.array([[0.1, 0.2, 0], [0.9, 0.3, 0], [1.2, 0, 0]])
    found = carried(single, np.zeros((1, 2), np.float32), other)[0] - other
    np.testing.assert_allclose(found, [[0.01, 0, 0], [0, 0.01, 0], [0, 0.01, 0]], atol=1e-8)


def errors(mean):
    keys = ("p95_mm", "ends_mm", "wrinkles_varying", "wrinkle_correlation")
    return {"mean_mm": mean, **dict.fromkeys(keys)}


@pytest.mark.parametrize(("ours", "verdict"), [(2.1, ": supported, ratio 1.05"), (3.0, ": not supported, ratio 1.50")])
def test_verdicts(ours, verdict):
    measured = [
        {"name": n, "how": how("tshirt-0", n), "single garment": errors(s), "ours": errors(o)}
        for n, s, o in (("tshirt-0", 2.0, ours), ("tshirt-1", 3.0, 3.0), ("unseen-dress-0", 30.0, 5.0))
    ]
    assert [m["how"] for m in measured] == [
        "its own garment",
        "its own design, carried over in UV",
        "carried over from the closest place",
    ]
    results = {"garment": "tshirt-0", "fabric": FABRIC, "training_shapes": 9, "bytes": 1000, "measured": measured}
    text = "\n".join(markdown(results))
    assert verdict in text
    assert "supported, on 1 of 1" in text
