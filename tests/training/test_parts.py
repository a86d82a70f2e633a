"""Gradients in parts are those of the whole batch."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from tryon_jax.training.parts import value_and_grad_in_parts
from tryon_jax.types import ArrayLike, pytree


@pytree
class Samples:
    """Two garments with six shapes each."""

    BY_SHAPE = ("targets",)

    garments: dict[str, Float[ArrayLike, "G 3"]]
    targets: Float[ArrayLike, "G B"]


@dataclass(frozen=True)
class Undivided:
    """Stands for batches that say nothing of shapes."""


def loss(params: dict[str, Float[Array, "3"]], batch: Samples) -> Float[Array, ""]:
    predicted = jnp.tanh(jnp.asarray(batch.garments["feature"]) @ params["weight"])
    return ((predicted[:, None] - batch.targets) ** 2).mean()


@pytest.fixture
def params():
    return {"weight": jnp.array([0.3, -0.2, 0.5])}


@pytest.fixture
def batch():
    rng = np.random.default_rng(0)
    return Samples({"feature": rng.normal(size=(2, 3))}, rng.normal(size=(2, 6)))


@pytest.mark.parametrize("shapes", [1, 2, 4, 6, 100])
def test_parts_have_the_gradient_of_the_whole(params, batch, shapes):
    with jax.enable_x64():
        params = jax.tree.map(lambda leaf: leaf.astype(jnp.float64), params)
        value, gradient = jax.jit(value_and_grad_in_parts(loss, shapes))(params, batch)
        expected, expected_gradient = jax.value_and_grad(loss)(params, batch)
    np.testing.assert_allclose(value, expected, rtol=1e-12)
    np.testing.assert_allclose(gradient["weight"], expected_gradient["weight"], rtol=1e-12)


def test_one_shape_is_seen_at_a_time(params, batch):
    seen = []

    def watching(params, batch):
        seen.append((batch.garments["feature"].shape, batch.targets.shape))
        return loss(params, batch)

    value_and_grad_in_parts(watching, 4)(params, batch)
    # 4 does not divide 6: the next smaller divisor does. (The first look only asks for the loss's type.)
    assert seen[-1] == ((1, 3), (1, 3))


def test_a_batch_without_shapes_stays_whole(params):
    def of_nothing(params, _batch):
        return (params["weight"] ** 2).sum()

    value, gradient = value_and_grad_in_parts(of_nothing, 1)(params, Undivided())
    np.testing.assert_allclose(value, 0.38, rtol=1e-6)
    np.testing.assert_allclose(gradient["weight"], 2 * params["weight"])


def test_a_negative_number_of_shapes_is_refused():
    with pytest.raises(ValueError, match="shapes at once = -1"):
        value_and_grad_in_parts(loss, -1)
