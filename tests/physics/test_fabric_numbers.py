"""A fabric's numbers: their meaning in cloth of known stiffness, what leaves them alone, their gradients."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.physics.fabric_numbers import FABRIC_NUMBERS, _compiled, fabric_numbers, host_fabric_numbers
from tryon_jax.physics.fabrics import Fabric, fabric_names, load_fabric

GRAVITY = 9.81


def plain_fabric(density: float, warp: float, weft: float, shear: float, bending: float) -> Fabric:
    """Cloth whose stiffness does not depend on strain."""
    table = np.broadcast_to(np.array([warp, 0.0, weft, shear]), (30, 30, 30, 4)).copy()
    parts = (density, table, np.full((3, 5), bending), 0.3, 0.005)
    return Fabric(*(jnp.asarray(part) for part in parts))


def test_numbers_are_bending_length_and_strain_of_a_metre() -> None:
    weight = 0.2 * GRAVITY
    found = np.exp(fabric_numbers(plain_fabric(0.2, 50.0, 100.0, 20.0, 3e-5)))
    wanted = [(3e-5 / weight) ** (1 / 3), weight / 50.0, weight / 100.0, weight / 20.0]
    np.testing.assert_allclose(found, wanted, rtol=1e-4)
    assert len(FABRIC_NUMBERS) == 4


def test_cloth_that_is_heavier_and_stiffer_alike_is_the_same() -> None:
    one = fabric_numbers(plain_fabric(0.2, 50.0, 100.0, 20.0, 3e-5))
    other = fabric_numbers(plain_fabric(0.5, 125.0, 250.0, 50.0, 7.5e-5))
    np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.parametrize("name", fabric_names())
def test_measured_fabrics_have_sensible_numbers(name: str) -> None:
    length, *give = np.exp(fabric_numbers(load_fabric(name)))
    assert 0.01 < length < 0.06
    assert all(1e-4 < g < 0.3 for g in give)


def test_gradients_to_the_tables_are_those_of_finite_differences(x64: None) -> None:
    fabric = jax.tree.map(lambda a: jnp.asarray(a, jnp.float64), load_fabric("gray-interlock"))

    def scaled(scales: jax.Array) -> jax.Array:
        changed = replace(
            fabric,
            density=fabric.density * scales[0],
            stretch_table=fabric.stretch_table * scales[1],
            bending=fabric.bending * scales[2],
        )
        return fabric_numbers(changed)

    jacobian = jax.jacobian(scaled)(jnp.ones(3))
    for k in range(3):
        step = jnp.zeros(3).at[k].set(1e-5)
        difference = (scaled(1.0 + step) - scaled(1.0 - step)) / 2e-5
        np.testing.assert_allclose(jacobian[:, k], difference, atol=1e-7)
    # log (B / ρg)^(1/3), and log (ρg / k) three times.
    np.testing.assert_allclose(jacobian, [[-1 / 3, 0, 1 / 3], [1, -1, 0], [1, -1, 0], [1, -1, 0]], atol=1e-7)


def test_numbers_on_the_host_are_the_same_and_compile_once_for_all_fabrics() -> None:
    for name in fabric_names():
        fabric = load_fabric(name)
        np.testing.assert_allclose(host_fabric_numbers(fabric), fabric_numbers(fabric), rtol=1e-6)
    assert _compiled._cache_size() == 1
