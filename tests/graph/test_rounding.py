"""Rounding of the mean drape moves neither the pooling hierarchy nor the drape."""

import jax
import numpy as np
import pytest

from tryon_jax.garment import placement, remesh
from tryon_jax.graph import bucket_size
from tryon_jax.tryon import Garment, TryOnModel, config_space, drape, load_pretrained, prepare_mesh

SHAPES = np.array([[1.5, -0.5], [-1.0, 1.0]], np.float32)


@pytest.fixture(scope="module")
def model() -> TryOnModel:
    return load_pretrained()


def assert_same_hierarchy(one: Garment, other: Garment) -> None:
    for mine, theirs in zip(jax.tree.leaves(one.graph.levels), jax.tree.leaves(other.graph.levels), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.slow
def test_rounding_of_the_mean_drape_changes_no_hierarchy_and_moves_no_drape(model: TryOnModel) -> None:
    """A micrometre moves the drape by less than 2 µm on average, and all but a few vertices by less than 0.01 mm.

    The largest move may be more, as R_fine sees positions as waves of centimetres and amplifies some of them; it is
    bounded all the same, so that nothing moves by a jump.
    """
    space = config_space(model.config)
    run = jax.jit(drape, static_argnames="fabric")
    rng = np.random.default_rng(0)
    meshes = [remesh(space, design, model.config.target_area) for design in space.sample(20, seed=3)]
    # All of one size, so that one program drapes them.
    bucket = bucket_size(int(1.05 * max(mesh.num_vertices for mesh in meshes)))
    far = []
    for mesh in meshes:
        garment = prepare_mesh(model, mesh, bucket=bucket)
        mean = garment.mean_vertices
        up = np.nextafter(mean, np.where(rng.random(mean.shape) < 0.5, np.inf, -np.inf).astype(mean.dtype))
        shaken = mean + rng.uniform(-1e-6, 1e-6, mean.shape).astype(mean.dtype)
        drapes = garment.unpad(run(model, garment, SHAPES))
        for moved, on_average, most in ((up, 2e-7, 1e-6), (shaken, 2e-6, 1.5e-5)):
            other = prepare_mesh(model, mesh, vertices=moved, bucket=bucket)
            assert_same_hierarchy(garment, other)
            distance = np.linalg.norm(other.unpad(run(model, other, SHAPES)) - drapes, axis=-1)
            assert distance.mean() < on_average
            assert distance.max() < most
        far.append(distance.ravel() > 1e-5)
    assert np.concatenate(far).mean() < 1e-4


def test_the_hierarchy_comes_from_the_flat_pattern(model: TryOnModel) -> None:
    space = config_space(model.config)
    mesh = remesh(space, space.mean_design, 8e-4)
    assert placement(mesh).shape == (mesh.num_vertices, 3)
    first, second = (prepare_mesh(model, mesh, vertices=placement(mesh) * s) for s in (1.0, 1.1))
    assert_same_hierarchy(first, second)
