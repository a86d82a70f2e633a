"""Sums of errors, maps between topologies and baselines without learning, on cases with known answers."""

import numpy as np
import pytest

from experiments.shared.errors import Errors
from experiments.shared.evaluate import map_pattern, ray_ends, spread
from experiments.shared.neighbours import shape_weights
from tryon_jax.garment import load_manifest, remesh
from tryon_jax.training.dataset import mesh_path, save_arrays


def test_errors_are_means_of_samples_and_percentiles_of_vertices():
    errors = Errors()
    errors.add(np.full((2, 100), 0.002), np.array([False, True]))
    one = np.full((1, 100), 0.004)
    one[0, :10] = 0.05
    errors.add(one, np.array([True]))
    found = errors.summary()
    assert found["samples"] == 3
    assert found["mean_mm"] == pytest.approx((2 + 2 + 8.6) / 3)
    assert found["ends_mm"] == pytest.approx((2 + 8.6) / 2)
    # 10 of 300 distances are large: the 95th percentile is 4 mm, to a bin of 0.1 mm.
    assert found["p95_mm"] == pytest.approx(4.0, abs=0.11)
    assert found["inside_percent"] is None
    both = Errors()
    both.update(errors)
    both.update(errors)
    assert both.summary()["mean_mm"] == pytest.approx(found["mean_mm"])
    assert both.summary()["samples"] == 6
    assert len(errors.means) == 3


def test_nothing_measured_is_none_not_zero():
    assert set(Errors().summary().values()) == {0, None}


def test_shapes_interpolate_exactly_where_known_and_linearly_between():
    known = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 0.5]])
    np.testing.assert_allclose(shape_weights(known, known), np.eye(5), atol=1e-9)
    wanted = np.array([[0.4, 0.3], [2.5, 0.5]])
    weights = shape_weights(known, wanted)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(weights @ (known @ np.array([2.0, -1.0]) + 0.5), wanted @ np.array([2.0, -1.0]) + 0.5)
    # Too few shapes for a plane: the closest one.
    np.testing.assert_array_equal(shape_weights(known[:2], wanted), [[1, 0], [0, 1]])
    # Shapes on a line say nothing about what lies beside it: without this a plate through them explodes.
    line = np.linspace(0, 1, 6)[:, None] * np.array([[1.0, 1.0]])
    assert shape_weights(line, np.array([[0.0, 1.0]])).max() == 1.0


def test_a_pattern_map_finds_the_same_place_of_the_cloth(tmp_path):
    manifest = load_manifest()
    design, places = manifest.design("tshirt"), {}
    for seed in (0, 1):
        mesh = remesh(manifest.space, design, 2e-3, seed=seed)
        arrays = {k: getattr(mesh, k) for k in ("faces", "uv", "faces_uv", "template_vertices", "template_weights")}
        save_arrays(mesh_path(tmp_path, f"tshirt-{seed}"), arrays)
        # A garment whose panels lie flat, the front before the back: linear in UV on each side.
        depth = np.zeros(mesh.num_vertices)
        sides = np.array([side == "front" for side in mesh.panel_sides])
        depth[mesh.faces[sides[mesh.panels]].ravel()] += 0.1
        depth[mesh.faces[~sides[mesh.panels]].ravel()] -= 0.1
        places[seed] = np.column_stack([mesh.uv[mesh.vertex_uv], depth])
        for vertices in mesh.seams.values():
            places[seed][vertices, 2] = 0.0
    onto = map_pattern(tmp_path, "tshirt-0", "tshirt-1")
    found = onto(places[1][None])[0]
    assert np.abs(found - places[0])[:, :2].max() < 0.02
    inner = np.abs(places[0][:, 2]) > 0.09
    assert (np.sign(found[inner, 2]) == np.sign(places[0][inner, 2])).all()


def test_spread_and_ray_ends():
    np.testing.assert_array_equal(spread(9, 3), [0, 4, 8])
    np.testing.assert_array_equal(spread(2, 3), [0, 1])
    np.testing.assert_array_equal(spread(4, 0), np.arange(4))
    np.testing.assert_array_equal(ray_ends(np.array([[3.0, 0.0], [0.0, -2.0], [1.5, 1.0]])), [True, True, False])
