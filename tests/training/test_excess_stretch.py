"""Edges that are too long cost; those within the limit and padding cost nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from tryon_jax.training.collisions import excess_stretch

FACES = jnp.array([[0, 1, 2], [0, 0, 0]])
SQUARE = jnp.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
REST = jnp.array([[1.0, 2.0**0.5, 1.0], [1.0, 1.0, 1.0]])


@pytest.mark.parametrize(("stretch", "expected"), [(1.0, 0.0), (1.2, 0.0), (1.5, 3 * 0.25**2 / 6)])
def test_only_what_is_beyond_the_limit_counts(stretch, expected):
    assert float(excess_stretch(stretch * SQUARE, FACES, REST, 1.25)) == pytest.approx(expected, abs=1e-6)


def test_its_gradient_pulls_the_ends_together(x64):
    points = 1.6 * SQUARE.astype(np.float64)
    check_grads(lambda x: excess_stretch(jnp.asarray(x), FACES, REST, 1.25), (points,), order=1, rtol=1e-5)
    gradient = jax.grad(lambda x: excess_stretch(x, FACES, REST, 1.25))(points)[0]
    assert float(gradient[1, 0]) > 0
    np.testing.assert_allclose(gradient.sum(axis=0), 0.0, atol=1e-12)
