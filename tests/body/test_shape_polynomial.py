"""Polynomials of a body's shape: what they reproduce, and what they say beyond their range."""

import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.body.shape_polynomial import fit_polynomials, polynomial_terms, shape_polynomials

AXES = (3.0, 2.0)


@pytest.mark.parametrize("count", [1, 2, 3, 10])
def test_they_are_determined_for_any_number_of_betas(count: int) -> None:
    polynomials = shape_polynomials((2.0,) * count)
    betas = jnp.asarray(polynomials.betas)
    terms = polynomial_terms(polynomials, betas)
    np.testing.assert_allclose(polynomials.fit @ np.asarray(terms), np.eye(len(polynomials.powers)), atol=1e-4)
    assert not np.asarray(betas)[0].any()
    assert np.linalg.norm(np.asarray(betas) / 2.0, axis=1).max() < 1 + 1e-6


def test_a_polynomial_of_degree_four_is_reproduced() -> None:
    def value(betas: np.ndarray) -> np.ndarray:
        x, y = betas[:, 0] / 3, betas[:, 1] / 2
        return np.stack([1 + x - y**2 + x * y**3, x**4], axis=1).astype(np.float32)

    polynomials = shape_polynomials(AXES)
    assert (len(polynomials.betas), len(polynomials.powers)) == (19, 15)
    fitted = fit_polynomials(polynomials, jnp.asarray(value(np.asarray(polynomials.betas))))
    betas = np.array([[0.4, -0.3], [-1.9, 0.8], [2.0, 1.4]], np.float32)
    found = np.asarray(polynomial_terms(polynomials, jnp.asarray(betas))) @ np.asarray(fitted).T
    np.testing.assert_allclose(found, value(betas), atol=1e-5)


def test_bodies_beyond_the_range_count_as_those_of_its_border() -> None:
    polynomials = shape_polynomials(AXES)
    border, beyond = jnp.array([[0.0, 2.0], [1.8, 1.6]]), jnp.array([[0.0, 4.5], [3.6, 3.2]])
    np.testing.assert_allclose(polynomial_terms(polynomials, border), polynomial_terms(polynomials, beyond), atol=1e-6)
