"""The coarse half of the preconditioner: patches of the flat pattern and Galerkin's matrix between them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import make_cloth, make_fabric, place, sheet, wavy
from hypothesis import given, settings
from hypothesis import strategies as st

from tryon_jax.physics.coarse import PATCH, coarse_correction, invert_coarse, make_patches
from tryon_jax.physics.linear import conjugate_gradients, multiply
from tryon_jax.physics.solver import internal_forces

solve = jax.jit(conjugate_gradients)


@given(count=st.integers(0, 300), panels=st.integers(1, 5), spare=st.integers(0, 3), seed=st.integers(0, 99))
@settings(max_examples=30)
def test_every_vertex_has_one_patch(count, panels, spare, seed):
    rng = np.random.default_rng(seed)
    padded = count + 20 * spare
    patches = make_patches(rng.uniform(size=(count, 2)), rng.integers(0, panels, count), padded)
    members, patch = np.asarray(patches.members), np.asarray(patches.patch)
    assert sorted(members[members < padded]) == list(range(count))
    sizes = (members < padded).sum(1)
    assert np.ptp(sizes) <= 1
    assert len(members) * PATCH >= padded
    assert (patch[count:] == len(members)).all()
    for number, row in enumerate(members):
        assert (patch[row[row < padded]] == number).all()


def test_patches_are_compact_and_keep_to_a_panel():
    side = np.linspace(0, 1, 16)
    square = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    # Two panels that lie on top of each other in the plane.
    patches = make_patches(np.concatenate([square, square]), np.repeat([0, 1], 256), 512)
    for row in np.asarray(patches.members):
        assert np.ptp(row // 256) == 0
        assert np.ptp(square[row % 256], axis=0).max() < 0.5


def stiff_system(size: int = 18):
    """The matrix of a wavy sheet that is held by next to nothing, and its patches; float64."""
    faces, uv = sheet(size, size, 0.3, 0.3)
    cloth, fabric = make_cloth(faces, uv), make_fabric()
    _, face_blocks, hinge_blocks = internal_forces(place(wavy(uv, 0), cloth), cloth, fabric)
    rows, slots = cloth.neighbours.shape
    blocks = jnp.zeros((rows * slots, 9)).at[cloth.face_slots.reshape(-1)].add(face_blocks.reshape(-1, 9))
    blocks = blocks.at[cloth.hinge_slots.reshape(-1)].add(hinge_blocks.reshape(-1, 9)).reshape(rows, slots, 3, 3)
    held = jnp.where(jnp.asarray(cloth.active) > 0, 0.05, 1.0)
    return blocks.at[:, 0].add(held[:, None, None] * jnp.eye(3)[None]), jnp.asarray(cloth.neighbours), cloth


def test_the_correction_is_symmetric_and_exact_on_patches(x64):
    blocks, neighbours, cloth = stiff_system()
    coarse = invert_coarse(blocks, neighbours, cloth.patches)
    rng = np.random.default_rng(0)
    a, b = jnp.asarray(rng.normal(size=(2, 3, len(blocks))))
    across = float(jnp.vdot(a, coarse_correction(coarse, b)))
    assert across == pytest.approx(float(jnp.vdot(b, coarse_correction(coarse, a))), rel=1e-9)
    assert float(jnp.vdot(a, coarse_correction(coarse, a))) > 0
    # Padding is neither seen nor moved.
    padding = np.asarray(cloth.active) == 0
    assert padding.any()
    assert not np.asarray(coarse_correction(coarse, a))[:, padding].any()
    moved = coarse_correction(coarse, a.at[:, padding].set(7.0))
    np.testing.assert_array_equal(moved, coarse_correction(coarse, a))
    # Patches moved as wholes are found again from the forces that move them, but for the ridge.
    moves = jnp.asarray(rng.normal(size=(3, len(cloth.patches.members) + 1))).at[:, -1].set(0)
    wanted = moves[:, cloth.patches.patch]
    forces = multiply(blocks.transpose(1, 2, 3, 0), neighbours.T, wanted)
    np.testing.assert_allclose(coarse_correction(coarse, forces), wanted, atol=0.05)


def test_the_solution_is_the_same_in_fewer_iterations(x64):
    blocks, neighbours, cloth = stiff_system()
    right = np.random.default_rng(1).normal(size=(len(blocks), 3)) * np.asarray(cloth.active)[:, None]
    coarse = invert_coarse(blocks, neighbours, cloth.patches)
    # Of another state of the cloth, as in a solve of many steps.
    old = invert_coarse(1.5 * blocks, neighbours, cloth.patches)
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
