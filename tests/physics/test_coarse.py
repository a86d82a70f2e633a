"""The coarse half of the preconditioner: Galerkin's matrix between patches."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import make_cloth, make_fabric, place, sheet, wavy

from tryon_jax.physics import coarse as coarse_module
from tryon_jax.physics.block_matrix import multiply
from tryon_jax.physics.coarse import coarse_correction, invert_coarse
from tryon_jax.physics.elasticity import deform, elastic_blocks
from tryon_jax.physics.linear import conjugate_gradients

solve = jax.jit(conjugate_gradients)


def stiff_system(size: int = 18):
    """The matrix of a wavy sheet that is held by next to nothing, and its patches; float64."""
    faces, uv = sheet(size, size, 0.3, 0.3)
    cloth, fabric = make_cloth(faces, uv), make_fabric()
    blocks = elastic_blocks(deform(place(wavy(uv, 0), cloth), cloth, fabric), cloth, fabric)
    held = jnp.where(jnp.asarray(cloth.active) > 0, 0.05, 1.0)
    blocks = replace(blocks, diagonal=blocks.diagonal + held[None, None] * jnp.eye(3)[..., None])
    return blocks, jnp.asarray(cloth.incidence.neighbours), cloth


def test_the_correction_is_symmetric_and_exact_on_patches(x64, monkeypatch):
    monkeypatch.setattr(coarse_module, "RIDGE", 0.0)
    blocks, neighbours, cloth = stiff_system()
    coarse = invert_coarse(blocks, neighbours, cloth.patches)
    rng = np.random.default_rng(0)
    a, b = jnp.asarray(rng.normal(size=(2, 3, neighbours.shape[1])))
    across = float(jnp.vdot(a, coarse_correction(coarse, b)))
    assert across == pytest.approx(float(jnp.vdot(b, coarse_correction(coarse, a))), rel=1e-9)
    assert float(jnp.vdot(a, coarse_correction(coarse, a))) > 0
    # Padding is neither seen nor moved.
    padding = np.asarray(cloth.active) == 0
    assert padding.any()
    assert not np.asarray(coarse_correction(coarse, a))[:, padding].any()
    moved = coarse_correction(coarse, a.at[:, padding].set(7.0))
    np.testing.assert_array_equal(moved, coarse_correction(coarse, a))
    # Patches moved as wholes are found again from the forces that move them.
    moves = jnp.asarray(rng.normal(size=(3, len(cloth.patches.members) + 1))).at[:, -1].set(0)
    wanted = moves[:, cloth.patches.patch]
    forces = multiply(blocks, neighbours, wanted)
    np.testing.assert_allclose(coarse_correction(coarse, forces), wanted, atol=1e-8)


def test_the_solution_is_the_same_in_fewer_iterations(x64):
    blocks, neighbours, cloth = stiff_system()
    right = np.random.default_rng(1).normal(size=(neighbours.shape[1], 3)) * np.asarray(cloth.active)[:, None]
    coarse = invert_coarse(blocks, neighbours, cloth.patches)
    # Of another state of the cloth, as in a solve of many steps.
    old = invert_coarse(jax.tree.map(lambda leaf: 1.5 * leaf, blocks), neighbours, cloth.patches)
    found = [
        solve(blocks, neighbours, jnp.asarray(right), jnp.asarray(1e-10), jnp.asarray(5000, jnp.int32), each)
        for each in (None, coarse, old)
    ]
    (plain, many), (helped, few), (late, some) = found
    size = np.abs(plain).max()
    np.testing.assert_allclose(helped, plain, atol=1e-6 * size)
    np.testing.assert_allclose(late, plain, atol=1e-6 * size)
    assert int(few) < 0.6 * int(many)
    assert int(some) < 0.7 * int(many)
