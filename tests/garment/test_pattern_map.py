"""A map through the pattern: the identity onto itself, exact for what is linear in the pattern, near elsewhere."""

import numpy as np
import pytest

from tryon_jax.garment import load_design_space, placement, remesh
from tryon_jax.garment.pattern_map import map_patterns, pattern_arrays

AREA = 1.2e-3
SPACE = load_design_space("kimono")


@pytest.fixture(scope="module")
def meshes():
    return [remesh(SPACE, SPACE.preset("tshirt"), AREA, seed=seed) for seed in (0, 1)]


def test_a_mesh_lies_on_itself(meshes):
    mesh = meshes[0]
    onto = map_patterns(pattern_arrays(mesh), pattern_arrays(mesh))
    values = np.random.default_rng(0).normal(size=(2, mesh.num_vertices, 3))
    np.testing.assert_allclose(onto(values), values, atol=1e-6)


def test_weights_are_barycentric(meshes):
    onto = map_patterns(pattern_arrays(meshes[0]), pattern_arrays(meshes[1]))
    assert onto.corners.shape == (meshes[0].num_vertices, 3)
    assert (onto.weights >= 0).all()
    np.testing.assert_allclose(onto.weights.sum(axis=1), 1.0, atol=1e-12)


def test_a_placed_garment_is_found_on_the_other_topology(meshes):
    # Panels are placed flat, one in front of the body and one behind it: linear in the pattern but for the bulge.
    onto = map_patterns(pattern_arrays(meshes[0]), pattern_arrays(meshes[1]))
    here, there = placement(meshes[0]), placement(meshes[1])
    distance = np.linalg.norm(onto(there[None])[0] - here, axis=1)
    assert np.median(distance) < 1e-3
    assert distance.max() < 0.5 * np.sqrt(AREA)  # a chord cuts the rounded shoulder by as much
