"""The fully connected baseline on data that a small network can learn, its dense mesh, its guard and its table."""

import jax
import numpy as np
import pytest

from experiments.paper.dense_network import (
    DenseGarment,
    DenseMeshes,
    DenseSamples,
    init_dense,
    load_samples,
    train_dense,
)
from experiments.paper.fully_connected import draw, markdown, summarise
from experiments.paper.memory import dense_bytes, dense_layers
from tests.experiments.tiny_garments import AREA, FABRIC, tiny_model
from tryon_jax.garment import DENSE_VERTICES, load_manifest, remesh
from tryon_jax.garment.pattern_map import PatternMap
from tryon_jax.training.dataset import mesh_path, save_arrays
from tryon_jax.training.loop import LoopOptions
from tryon_jax.tryon import config_space


def samples(design, rng, vertices=5):
    """Displacements that are a product of design and betas: no linear map gives them."""
    betas = rng.uniform(-1.5, 1.5, (84, 2)).astype(np.float32)
    mean = rng.normal(size=(vertices, 3)).astype(np.float32)
    move = np.zeros((84, vertices, 3), np.float32)
    move[:, :, 0] = 0.02 * betas[:, :1] * (1 + design[0])
    move[:, :, 1] = 0.01 * betas[:, 1:]
    onto = PatternMap(np.repeat(np.arange(vertices)[:, None], 3, axis=1), np.full((vertices, 3), 1 / 3))
    garment = DenseGarment(None, mean, np.asarray(design, np.float32))  # type: ignore[arg-type]
    return DenseSamples(garment, onto, betas, mean[None] + move, np.arange(80), np.arange(80, 84))


def test_it_learns_and_continues_where_it_stopped(tmp_path):
    rng = np.random.default_rng(0)
    data = [samples(np.array([p, 0.0, 0.0]), rng) for p in (-0.8, 0.0, 0.8)]
    options = LoopOptions(steps=1500, learning_rate=1e-2, warmup=10, evaluate_every=750)
    network, result = train_dense(data, [5, 24, 15], tmp_path, options, 16, {"data": "toy"})
    assert result.curve[-1]["validation"] < 2.0
    held = data[2]
    predicted = network(held.garment, held.betas[held.validation])
    assert 1e3 * np.abs(predicted - held.drapes[held.validation]).mean() < 1.0
    again, _ = train_dense(data, [5, 24, 15], tmp_path, options, 16, {"data": "toy"})
    np.testing.assert_array_equal(again.mlp.weights[0], network.mlp.weights[0])
    with pytest.raises(ValueError, match="holds another run"):
        train_dense(data, [5, 24, 15], tmp_path, options, 16, {"data": "other"})


def test_units_bend_over_the_range_of_designs_and_betas():
    """With hundreds of units on five inputs, too: what they give is no straight line."""
    network = init_dense(jax.random.key(0), [5, 806, 3])
    along = np.linspace(-1.0, 1.0, 41)
    inputs = np.zeros((41, 5), np.float32)
    inputs[:, 0] = along
    given = np.tanh(inputs @ np.asarray(network.weights[0]))
    straight = np.outer(along, along @ given) / (along @ along)
    assert np.linalg.norm(given - straight) > 0.03 * np.linalg.norm(given)


def test_the_papers_size():
    layers = dense_layers(167.0, 5, 3 * DENSE_VERTICES)
    assert layers == [5, 806, 51_738]
    assert dense_bytes(layers) == 4 * (5 * 806 + 806 + 806 * 51_738 + 51_738) == 167_029_608


@pytest.mark.slow
def test_the_dense_mesh_is_one_for_all_designs_and_lies_on_the_simulated_cloth(tmp_path):
    model, manifest = tiny_model(), load_manifest()
    meshes = DenseMeshes(model, manifest, 1200)
    shirt, dress = meshes("tshirt"), meshes("dress")
    np.testing.assert_array_equal(shirt.mesh.faces, dress.mesh.faces)
    assert shirt.mean.shape == (1200, 3)
    assert np.ptp(dress.mean[:, 1]) > np.ptp(shirt.mean[:, 1]) + 0.2
    cloth = remesh(config_space(model.config), manifest.design("dress"), AREA, seed=0)
    arrays = {k: getattr(cloth, k) for k in ("faces", "uv", "faces_uv", "template_vertices", "template_weights")}
    save_arrays(mesh_path(tmp_path, "dress-0"), arrays)
    # What is linear in the pattern is carried there and back without loss, but for the corners that meshes cut.
    height = np.zeros((1, cloth.num_vertices, 3))
    height[0, :, 1] = cloth.uv[cloth.vertex_uv][:, 1]
    back = meshes.back(tmp_path, "dress-0")(meshes.onto(tmp_path, "dress-0")(height))
    assert np.abs(back - height).max() < 0.02
    assert np.median(np.abs(back - height)[0, :, 1]) < 1e-6


def test_test_garments_are_refused(tmp_path):
    meshes = DenseMeshes(None, load_manifest(), 1200)  # type: ignore[arg-type]
    for name in ("unseen-dress-0", "tshirt-100"):
        with pytest.raises(PermissionError, match=f"{name} is a test garment"):
            load_samples(meshes, tmp_path, [name], FABRIC)


def entry(name, ours, theirs):
    betas = [[1.5, 0.0], [0.0, 1.0]]
    sides = {"ours": ours, "fully connected": theirs}
    return {
        "name": name,
        "betas": betas,
        "vertices": 9,
        **{m: {"hausdorff_mm": v, "vertex_mm": [x / 4 for x in v]} for m, v in sides.items()},
    }


def results(*unseen):
    found = {"unseen": list(unseen), "trained": []}
    return {
        "layers": [5, 806, 51_738],
        "bytes": {"fully connected": 167_029_608, "ours": 400_000},
        "training": {"samples": 10, "garments": 2, "steps": 5, "seconds": 60, "curve": []},
        "designs": found,
        **summarise(found),
    }


def test_the_verdict_needs_every_shape_of_every_design(tmp_path):
    better, mixed = entry("unseen-a-0", [10.0, 12.0], [20.0, 24.0]), entry("unseen-b-0", [10.0, 12.0], [20.0, 11.0])
    found = results(better)
    assert found["summary"]["unseen"]["factor"] == pytest.approx(2.0)
    assert "supported (lower on 2 of 2; on average by the factor 2.00)" in markdown(found)[-1]
    found = results(better, mixed)
    assert "not supported (lower on 3 of 4" in markdown(found)[-1]
    assert "167,029,608 bytes" in markdown(found)[0]
    draw(tmp_path / "a.png", found)
    assert (tmp_path / "a.png").stat().st_size > 1000
    assert "not measured" in markdown(results())[-1]


def test_a_design_without_shapes_is_no_number():
    empty = replace_betas(entry("unseen-c-0", [], []))
    assert "| unseen-c-0 (unseen) | 0 | – |" in "\n".join(markdown(results(empty)))


def replace_betas(found):
    return {**found, "betas": []}
