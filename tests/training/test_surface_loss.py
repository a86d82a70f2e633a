"""Errors of edges and normals: known values, blind to padding and to where the surface is, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from tests.physics.cloth_scenes import sheet
from tryon_jax.training.surface_loss import edge_error, normal_error

FACES, UV = sheet(5, 5, 0.1, 0.1)
FLAT = jnp.asarray(np.column_stack([UV, np.zeros(len(UV))]), jnp.float32)
ERRORS = (edge_error, normal_error)


def turned(degrees: float) -> jax.Array:
    """The sheet turned about its first axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return FLAT @ jnp.asarray([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]], jnp.float32)


@pytest.mark.parametrize("error", ERRORS)
def test_a_shift_is_no_error_and_has_no_gradient(error):
    value, gradient = jax.value_and_grad(error)(FLAT + 0.01, FLAT, FACES)
    np.testing.assert_allclose(value, 0.0, atol=1e-5)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-2)


def test_a_tenth_longer_is_a_tenth():
    np.testing.assert_allclose(edge_error(1.1 * FLAT, FLAT, FACES), 0.1, rtol=0.02)
    np.testing.assert_allclose(normal_error(1.1 * FLAT, FLAT, FACES), 0.0, atol=1e-6)


@pytest.mark.parametrize("degrees", [10.0, 60.0])
def test_normals_turn_with_the_sheet(degrees):
    np.testing.assert_allclose(normal_error(turned(degrees), FLAT, FACES), 1 - np.cos(np.radians(degrees)), atol=1e-5)


@pytest.mark.parametrize("error", ERRORS)
def test_padding_changes_nothing(error):
    padded = np.concatenate([FACES, np.zeros((7, 3), FACES.dtype)])
    more = jnp.concatenate([turned(30.0), jnp.ones((4, 3))])
    target = jnp.concatenate([FLAT, jnp.zeros((4, 3))])
    np.testing.assert_allclose(error(more, target, padded), error(turned(30.0), FLAT, FACES), rtol=1e-6)


@pytest.mark.parametrize("error", ERRORS)
def test_gradients_against_finite_differences(x64, error):
    rng = np.random.default_rng(0)
    target = jnp.asarray(np.column_stack([UV, np.zeros(len(UV))]))
    predicted = target + jnp.asarray(rng.normal(scale=2e-3, size=target.shape))
    check_grads(lambda x: error(jnp.asarray(x), target, FACES), (predicted,), 1, modes=["rev"], eps=1e-7, rtol=1e-4)
