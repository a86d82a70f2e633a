"""The loss of R_smooth and R_fine.

Errors: known values, blind to padding. The energy term: a physical height, blind to padding, smallest where cloth is at
rest and low.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.physics.cloth_scenes import horizontal, make_cloth, make_fabric, place, sheet, wavy
from tryon_jax.training.stage_loss import displacement_error, relative_energy

FACES, UV = sheet(5, 5, 0.1, 0.1)
CLOTH = make_cloth(FACES, UV, np.float32)
FABRIC = make_fabric()
energy = jax.jit(relative_energy)
MASK = jnp.arange(6)[None] < jnp.array([[6], [2]])
"""Two garments, of six vertices and of two."""


def displaced(seed: int = 0) -> tuple[jax.Array, jax.Array]:
    """Targets of two garments in three shapes, and predictions 20 mm off wherever there is a vertex."""
    keys = jax.random.split(jax.random.key(seed), 3)
    targets = jax.random.normal(keys[0], (2, 3, 6, 3))
    direction = jax.random.normal(keys[1], targets.shape)
    moved = 0.02 * direction / jnp.linalg.norm(direction, axis=-1, keepdims=True)
    padding = jnp.where(MASK[:, None, :, None], 0.0, jax.random.normal(keys[2], targets.shape))
    return targets + moved + padding, targets


@pytest.mark.parametrize(("distance", "expected"), [("squared", 4.0 / 3), ("plain", 2.0 - 0.01)])
def test_an_even_error_has_its_size_whatever_lies_in_the_padding(distance, expected):
    predicted, targets = displaced()
    error = displacement_error(predicted, targets, MASK, jnp.asarray(0.01), distance)
    np.testing.assert_allclose(error, expected, rtol=1e-4)


@pytest.mark.parametrize("distance", ["squared", "plain"])
def test_no_error_has_no_gradient(distance):
    _, targets = displaced()
    value, gradient = jax.value_and_grad(displacement_error)(targets, targets, MASK, jnp.asarray(0.01), distance)
    assert value == 0
    np.testing.assert_array_equal(gradient, 0)


def test_between_two_folds_squares_choose_the_mean_and_distances_the_more_frequent():
    """Ten drapes of one vertex: three fold to 1 cm, seven to -1 cm."""
    where = jnp.where(jnp.arange(10) < 3, 0.01, -0.01)
    targets = jnp.zeros((1, 10, 1, 3)).at[0, :, 0, 0].set(where)
    candidates = jnp.linspace(-0.01, 0.01, 201)

    def best(distance: str) -> jax.Array:
        def error(x: jax.Array) -> jax.Array:
            predicted = jnp.zeros((1, 10, 1, 3)).at[..., 0].set(x)
            return displacement_error(predicted, targets, jnp.ones((1, 1), bool), jnp.asarray(0.01), distance)

        return candidates[jnp.argmin(jax.vmap(error)(candidates))]

    np.testing.assert_allclose(best("squared"), -0.004, atol=1e-4)
    np.testing.assert_allclose(best("plain"), -0.01, atol=1e-4)


def test_lifting_a_flat_sheet_by_a_millimetre_adds_one():
    low, high = place(horizontal(UV), CLOTH), place(horizontal(UV, 1e-3), CLOTH)
    np.testing.assert_allclose(energy(high, CLOTH, FABRIC) - energy(low, CLOTH, FABRIC), 1.0, rtol=1e-4)


def test_stretching_and_bending_cost_energy():
    flat = horizontal(UV)
    crumpled = wavy(UV, seed=0)
    crumpled -= crumpled.mean(axis=0)
    assert energy(place(crumpled, CLOTH), CLOTH, FABRIC) > energy(place(flat, CLOTH), CLOTH, FABRIC) + 1.0


def test_padding_is_not_felt():
    x = place(wavy(UV, seed=1), CLOTH)
    gradient = jax.grad(relative_energy)(x, CLOTH, FABRIC)
    assert np.isfinite(np.asarray(gradient)).all()
    assert not np.asarray(gradient[len(UV) :]).any()
    moved = jnp.concatenate([x[: len(UV)], x[len(UV) :] + 1.0])
    np.testing.assert_allclose(energy(moved, CLOTH, FABRIC), energy(x, CLOTH, FABRIC), rtol=1e-6)
