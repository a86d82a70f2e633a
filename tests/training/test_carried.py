"""Drapes carried over to fresh topologies: the same surface, the same splits, nothing of a test."""

from dataclasses import replace

import numpy as np
import pytest

from tests.experiments.tiny_garments import AREA, FABRIC, stretched, tiny_model
from tryon_jax.garment import load_manifest, remesh
from tryon_jax.mesh.closest_points import MeshSearch
from tryon_jax.training.carried import FIRST_SEED, carry_over, fresh_topologies
from tryon_jax.training.dataset import mesh_path, save_arrays
from tryon_jax.training.garments import training_shapes
from tryon_jax.training.stage_sets import split_validation
from tryon_jax.tryon import config_space

MANIFEST = load_manifest()


@pytest.fixture(scope="module")
def model():
    return tiny_model()


@pytest.fixture(scope="module")
def samples(model):
    return stretched(model)


@pytest.fixture(scope="module")
def source_mesh(model):
    return remesh(config_space(model.config), MANIFEST.design("tshirt"), AREA, seed=0)


@pytest.fixture(scope="module")
def root(source_mesh, tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    arrays = {"faces": source_mesh.faces, "uv": source_mesh.uv, "faces_uv": source_mesh.faces_uv}
    for name in ("tshirt-0", "tshirt-100", "unseen-tank-0"):
        save_arrays(mesh_path(folder, name), arrays)
    return folder


@pytest.fixture(scope="module")
def carried(model, root, samples):
    return carry_over(model, root, samples, MANIFEST, FIRST_SEED)


def test_carried_vertices_lie_on_the_simulated_surface(carried, samples, source_mesh):
    rows = np.flatnonzero(training_shapes(samples, MANIFEST))
    count, old = carried.garment.num_vertices, samples.garment.num_vertices
    assert not np.array_equal(carried.garment.graph.vertices, samples.garment.graph.vertices)
    for k in (0, len(rows) - 1):
        surface = samples.drapes[FABRIC][rows[k], :old].astype(float)
        points = carried.drapes[FABRIC][k, :count].astype(float)
        nearest = MeshSearch(surface, source_mesh.faces).closest(points).position
        np.testing.assert_allclose(points, nearest, atol=1e-6)
    assert not carried.drapes[FABRIC][:, count:].any()


def test_no_test_shape_is_carried_and_nothing_of_it_chooses_weights(carried, samples):
    assert not carried.test.any()
    assert len(carried.betas) == training_shapes(samples, MANIFEST).sum()
    train, validation = split_validation(samples, MANIFEST)
    fresh_train, fresh_validation = split_validation(carried, MANIFEST)
    np.testing.assert_array_equal(carried.betas[fresh_train], samples.betas[train])
    assert validation.any()
    assert not fresh_validation.any()


def test_test_garments_and_test_topologies_are_refused(model, root, samples, carried):
    for name in ("tshirt-100", "unseen-tank-0"):
        with pytest.raises(PermissionError, match="test garment"):
            carry_over(model, root, replace(samples, name=name), MANIFEST, FIRST_SEED)
    with pytest.raises(ValueError, match="seed 100 is a topology of the splits"):
        carry_over(model, root, samples, MANIFEST, 100)
    with pytest.raises(PermissionError, match="tshirt-100"):
        training_shapes(replace(carried, name="tshirt-100"), MANIFEST)


def test_every_garment_gets_its_own_topologies_but_those_that_choose_weights(model, root, samples):
    choosing = replace(samples, name=f"{MANIFEST.validation[0]}-0")
    fresh = fresh_topologies(model, root, [samples, choosing], MANIFEST, 2)
    assert [s.source for s in fresh] == ["tshirt-0", "tshirt-0"]
    assert len({s.seed for s in fresh}) == 2
    assert not fresh_topologies(model, root, [samples], MANIFEST, 0)
