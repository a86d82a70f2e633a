"""R_mean: size, normalisation, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.test_util import check_grads

from tryon_jax.nets import apply_mean_drape, apply_mlp, count_parameters, init_mean_drape, init_mlp


def test_paper_size():
    mlp = init_mlp(jax.random.key(0), (3, 10, 3 * 403))
    assert count_parameters(mlp) == 3 * 10 + 10 + 10 * 1209 + 1209


def test_equals_the_formula():
    mlp = init_mlp(jax.random.key(0), (2, 4, 3))
    x = np.array([[0.3, -1.0], [2.0, 0.1]], np.float32)
    hidden = np.tanh(x @ np.asarray(mlp.weights[0]) + np.asarray(mlp.biases[0]))
    expected = hidden @ np.asarray(mlp.weights[1]) + np.asarray(mlp.biases[1])
    np.testing.assert_allclose(apply_mlp(mlp, jnp.asarray(x)), expected, rtol=1e-5)
    np.testing.assert_allclose(apply_mlp(mlp, jnp.asarray(x[0])), expected[0], rtol=1e-5)


def test_mean_drape_is_centred_and_differentiable(x64):
    center = np.random.default_rng(0).normal(size=(5, 3))
    mean = init_mean_drape(jax.random.key(0), np.array([0.2, 1.0]), np.array([0.1, 0.2]), center)
    np.testing.assert_allclose(apply_mean_drape(mean, jnp.array([0.2, 1.0])), center, atol=1e-12)
    check_grads(lambda p: apply_mean_drape(mean, jnp.asarray(p)), (jnp.array([0.25, 0.9]),), order=1)
