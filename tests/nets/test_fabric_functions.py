"""Fabric functions: kriging against its defining properties, the hyperbolic cross, the sum over fields."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.nets.fabric_functions import apply_fabric_functions, field_pairs, fit_fabric_functions, mix_fields

NUMBERS = np.random.default_rng(0).normal(size=(8, 4)) * [0.2, 1.5, 1.0, 0.5] - 3.0
VALUES = np.random.default_rng(1).normal(size=(8, 3))
applied = jax.jit(jax.vmap(apply_fabric_functions, (None, 0)))


def test_a_constant_function_is_constant_everywhere() -> None:
    functions = fit_fabric_functions(NUMBERS, np.ones((8, 1)))
    far = jnp.asarray(np.concatenate([NUMBERS, NUMBERS + 5.0]), jnp.float32)
    np.testing.assert_allclose(applied(functions, far), 1.0, atol=1e-5)


def test_trained_fabrics_keep_most_of_their_values() -> None:
    found = np.asarray(applied(fit_fabric_functions(NUMBERS, VALUES), jnp.asarray(NUMBERS, jnp.float32)))
    spread = VALUES - VALUES.mean(axis=0)
    assert ((found - VALUES) ** 2).sum() < 0.1 * (spread**2).sum()


def test_units_of_the_numbers_do_not_matter() -> None:
    factors = np.array([2.0, 0.1, 5.0, 1.0])
    there = NUMBERS.mean(axis=0)[None] + 0.3
    one = applied(fit_fabric_functions(NUMBERS, VALUES), jnp.asarray(there, jnp.float32))
    other = applied(
        fit_fabric_functions(NUMBERS * factors + 7.0, VALUES), jnp.asarray(there * factors + 7.0, jnp.float32)
    )
    np.testing.assert_allclose(one, other, atol=1e-4)


def test_the_gradient_is_that_of_finite_differences(x64: None) -> None:
    functions = jax.tree.map(lambda a: jnp.asarray(a, jnp.float64), fit_fabric_functions(NUMBERS, VALUES))
    at = jnp.asarray(NUMBERS.mean(axis=0) + 0.2)
    jacobian = jax.jacobian(apply_fabric_functions, argnums=1)(functions, at)
    for k in range(4):
        step = jnp.zeros(4).at[k].set(1e-5)
        difference = apply_fabric_functions(functions, at + step) - apply_fabric_functions(functions, at - step)
        np.testing.assert_allclose(jacobian[:, k], difference / 2e-5, atol=1e-8)


@pytest.mark.parametrize(("fields", "functions", "count"), [(24, 1, 24), (24, 6, 58), (4, 8, 8)])
def test_small_products_are_left_out(fields: int, functions: int, count: int) -> None:
    pairs = field_pairs(fields, functions)
    assert len(pairs) == len(set(pairs)) == count
    assert all(0 <= k < fields and 0 <= j < functions and (k + 1) * (j + 1) <= fields for k, j in pairs)


def test_mixed_fields_are_the_sum_over_pairs() -> None:
    rng, pairs = np.random.default_rng(2), field_pairs(6, 3)
    fields, values = rng.normal(size=(5, 3, len(pairs))), rng.normal(size=3)
    expected = np.zeros((5, 3, 6))
    for m, (k, j) in enumerate(pairs):
        expected[..., k] += values[j] * fields[..., m]
    found = mix_fields(jnp.asarray(fields, jnp.float32), jnp.asarray(values, jnp.float32), pairs, 6)
    np.testing.assert_allclose(found, expected, atol=1e-5)
