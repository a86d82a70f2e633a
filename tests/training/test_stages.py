"""The energy term of R_fine's loss: a physical height, blind to padding, smallest where cloth is at rest and low."""

import jax
import jax.numpy as jnp
import numpy as np

from tests.physics.cloth_scenes import horizontal, make_cloth, make_fabric, place, sheet, wavy
from tryon_jax.training.stages import relative_energy

FACES, UV = sheet(5, 5, 0.1, 0.1)
CLOTH = make_cloth(FACES, UV, np.float32)
FABRIC = make_fabric()
energy = jax.jit(relative_energy)


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
