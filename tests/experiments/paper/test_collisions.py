"""What is counted as a collision, on garments of which so many vertices lie so deep in the body."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from experiments.paper import collisions
from experiments.shared.evaluate import Prediction, load_all
from experiments.shared.record import read_result
from tests.experiments.known_data import FABRICS, TEST
from tryon_jax.body import vertex_normals
from tryon_jax.training.collisions import pool_garment
from tryon_jax.tryon import config_space

DEPTH = 0.005
UP = np.array([0.0, 2.0, 0.0])


def belly(model):
    """A point 5 mm below the skin of the mean body's front, at the height of the waist."""
    vertices, faces = np.asarray(model.body.v_template), np.asarray(model.body.faces)
    front = np.flatnonzero((np.abs(vertices[:, 0]) < 0.05) & (np.abs(vertices[:, 1] - 0.1) < 0.03))
    chosen = front[vertices[front, 2].argmax()]
    return vertices[chosen] - DEPTH * np.asarray(vertex_normals(vertices, faces))[chosen]


@pytest.mark.slow
def test_vertices_put_below_the_skin_are_counted_with_their_depth(known, monkeypatch):
    """Above the head but for three vertices; the simulation is above the head in whole."""
    name, model = "tshirt-0", known.model
    garments = load_all(model, known.data, [name])
    samples = garments[name]
    # The mean body alone, of which the point is known.
    samples.betas[:], count = 0.0, samples.garment.num_vertices
    for fabric in FABRICS:
        samples.drapes[fabric][:, :count] = samples.garment.mean_vertices + UP

    class Known:
        def __init__(self, _model):
            """Predicts what is known."""

        def __call__(self, samples, rows, fabrics):
            fine = np.repeat((samples.garment.mean_vertices + UP)[None], len(rows), axis=0)
            fine[:, :3] = belly(model)
            return {fabric: Prediction(fine, fine) for fabric in fabrics}

    monkeypatch.setattr(collisions, "Pipeline", Known)
    found = collisions.measure(model, garments, {"known": [name], "none": []}, FABRICS, 0, pushed=True)
    assert set(found) == {"known"}
    row = found["known"]
    assert row["samples"] == TEST.sum() * len(FABRICS)
    assert row["vertices_percent"] == pytest.approx(100 * 3 / count)
    assert row["simulation_vertices_percent"] == 0.0
    # Faces pass from the belly through the body to above the head: deeper than their corners, not less deep.
    assert row["deepest_mm"] >= 1e3 * DEPTH - 0.5
    moved = np.linalg.norm(samples.garment.mean_vertices[:3] + UP - belly(model), axis=1)
    assert row["error_mm"] == pytest.approx(1e3 * moved.sum() / count, rel=1e-4)
    assert row["pushed_out_inside_percent"] == 0.0
    assert row["pushed_out_largest_move_mm"] >= 1e3 * DEPTH - 0.5


@pytest.mark.slow
def test_the_record_has_the_error_of_each_case(known, tmp_path, monkeypatch):
    def two_shirts(model, count, seed):
        design, tree = config_space(model.config).preset("tshirt"), cKDTree(np.asarray(model.body.v_template))
        return [pool_garment(model, design, seed, tree)] * count

    # Few random designs have a clean surface in so few triangles.
    monkeypatch.setattr(collisions, "make_pool", two_shirts)
    collisions.main(collisions.Config(known.data, known.run, out=tmp_path, garments=0, random=2))
    record = read_result(tmp_path, "collisions")
    assert record is not None
    assert record["results"]["collision_step"] == {}
    measured = record["results"]["measured"]
    for case, error in (("as trained", 1.0), ("unseen topology", 2.0), ("unseen design", 0.0)):
        assert measured[case]["error_mm"] == pytest.approx(error, abs=1e-3)
        assert measured[case]["pushed_out_inside_percent"] == 0.0
    # The prediction is the simulation: as much of it lies inside.
    same = measured["unseen design"]
    assert same["vertices_percent"] == pytest.approx(same["simulation_vertices_percent"])
    random = record["results"]["random"]
    assert set(random) == {collisions._ALONE, collisions._CLEAR}
    for rows in random.values():
        assert {row["drapes"] for row in rows.values()} == {2 * 4}
    alone, clear = (random[key][FABRICS[0]]["vertices_percent"] for key in (collisions._ALONE, collisions._CLEAR))
    assert clear < 0.5 * alone


def test_collisions_before_and_after():
    step = {"inside_training_percent": [2.0, 0.5], "inside_held_out_percent": [1.0, 1.1]}
    lines = "\n".join(collisions.markdown({"collision_step": {"x": step}, "measured": {}}))
    assert "| x, training garments | 2.000 | 0.500 | -75 % | -70 % |" in lines
    assert "| x, unseen garments | 1.000 | 1.100 | +10 % | -20 % |" in lines
    assert "not measured" in collisions.markdown({"collision_step": {}, "measured": {}})[0]
    row = {"samples": 3, "vertices_percent": 2.0, "surface_percent": 2.5, "mean_deepest_mm": 1.0, "deepest_mm": 4.0}
    row |= {"simulation_vertices_percent": 0.0, "error_mm": 3.5}
    pushed = {"pushed_out_inside_percent": 0.0, "pushed_out_largest_move_mm": 5.0, "pushed_out_error_mm": 3.25}
    results = {"collision_step": {"x": step}, "measured": {"seen": row | pushed}, "measured_before": {"seen": row}}
    lines = "\n".join(collisions.markdown(results))
    assert "| seen (3 drapes), before the collision step | 2.00 | 2.50 | 1.0 · 4.0 | 0.00 | 3.50 |" in lines
    assert "| seen | 0.000 | 5.0 | 3.25 |" in lines
    results |= {"random": {"alone": {"x": {"drapes": 8, "vertices_percent": 1.25, "mean_deepest_mm": 2.0}}}}
    assert "| alone (8 drapes) | 1.2500 · 2.00 |" in "\n".join(collisions.markdown(results))
