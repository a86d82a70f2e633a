"""The linear solver against dense algebra."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import make_cloth, sheet
from hypothesis import given, settings
from hypothesis import strategies as st

from tryon_jax.physics.block_matrix import BlockMatrix, invert_blocks, multiply
from tryon_jax.physics.coarse import invert_coarse
from tryon_jax.physics.linear import conjugate_gradients

solve = jax.jit(conjugate_gradients)


def random_system(seed: int) -> tuple[BlockMatrix, np.ndarray, np.ndarray]:
    """Blocks on the sparsity of a sheet, its columns, and the same matrix dense: positive definite."""
    faces, uv = sheet(5, 4, 0.1, 0.08)
    neighbours = np.asarray(make_cloth(faces, uv).incidence.neighbours)
    count = neighbours.shape[1]
    rng = np.random.default_rng(seed)
    dense = np.zeros((count, count, 3, 3))
    for face in faces:
        factor = rng.normal(size=(9, 4))
        block = (factor @ factor.T).reshape(3, 3, 3, 3).transpose(0, 2, 1, 3)
        for i in range(3):
            for j in range(3):
                dense[face[i], face[j]] += block[i, j]
    for k in range(count):
        dense[k, k] += rng.uniform(0.1, 3) * np.eye(3)
    own = np.arange(count)
    # An empty slot names the row itself and stays zero.
    beside = np.where((neighbours != own)[..., None, None], dense[own, neighbours], 0.0)
    blocks = BlockMatrix(jnp.asarray(dense[own, own].transpose(1, 2, 0)), jnp.asarray(beside.transpose(0, 2, 3, 1)))
    return blocks, neighbours, dense.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=10)
def test_solves_a_known_system(seed: int) -> None:
    with jax.enable_x64(True):
        blocks, neighbours, dense = random_system(seed)
        right = np.random.default_rng(seed + 1).normal(size=(len(dense) // 3, 3))
        y, iterations = solve(
            blocks,
            jnp.asarray(neighbours),
            jnp.asarray(right),
            jnp.asarray(1e-11),
            jnp.asarray(1000, jnp.int32),
        )
        expected = np.linalg.solve(dense, right.ravel())
        np.testing.assert_allclose(np.asarray(y).ravel(), expected, atol=1e-7 * np.abs(expected).max())
        assert 0 < int(iterations) < 400


def test_product_is_the_dense_one(x64: None) -> None:
    blocks, neighbours, dense = random_system(3)
    y = np.random.default_rng(0).normal(size=(len(dense) // 3, 3))
    ours = multiply(blocks, jnp.asarray(neighbours), jnp.asarray(y.T))
    np.testing.assert_allclose(np.asarray(ours).T.ravel(), dense @ y.ravel(), rtol=1e-9, atol=1e-9)


def test_tolerance_and_cap_are_kept(x64: None) -> None:
    blocks, neighbours, dense = random_system(4)
    right = jnp.asarray(np.random.default_rng(1).normal(size=(len(dense) // 3, 3)))
    counts = [
        int(solve(blocks, neighbours, right, jnp.asarray(t), jnp.asarray(500, jnp.int32))[1]) for t in (0.1, 1e-3, 1e-9)
    ]
    assert counts[0] < counts[1] < counts[2]
    _, few = solve(blocks, neighbours, right, jnp.asarray(1e-12), jnp.asarray(3, jnp.int32))
    assert int(few) == 3
    # Nothing to solve: no iteration, no division of zero by zero.
    y, none = solve(blocks, neighbours, jnp.zeros_like(right), jnp.asarray(0.1), jnp.asarray(10, jnp.int32))
    assert int(none) == 0
    assert not np.asarray(y).any()
    # The tolerance is relative to the right-hand side in the norm of the preconditioner.
    y, _ = solve(blocks, neighbours, right, jnp.asarray(1e-3), jnp.asarray(500, jnp.int32))
    left_over = (np.asarray(right).ravel() - np.asarray(dense) @ np.asarray(y).ravel()).reshape(-1, 3)
    inverse = np.linalg.inv(np.asarray(blocks.diagonal).transpose(2, 0, 1))
    norm = [np.einsum("vi,vij,vj", r, inverse, r) ** 0.5 for r in (left_over, np.asarray(right))]
    assert norm[0] <= 1.0001e-3 * norm[1]


@pytest.mark.parametrize("with_patches", [False, True])
def test_pinned_rows_are_zero_and_the_others_solve_their_own_system(x64: None, with_patches: bool) -> None:
    blocks, neighbours, dense = random_system(6)
    faces, uv = sheet(5, 4, 0.1, 0.08)
    right = np.random.default_rng(1).normal(size=(len(dense) // 3, 3))
    pinned = np.zeros(len(dense) // 3, bool)
    pinned[[0, 3, 17]] = True
    # A load on a pin, however large, is nobody else's.
    right[pinned] = 1e6
    blocks, neighbours, held = blocks, jnp.asarray(neighbours), jnp.asarray(pinned)
    patches = make_cloth(faces, uv).patches
    coarse = invert_coarse(blocks, neighbours, patches, held) if with_patches else None
    goal, most = jnp.asarray(1e-11), jnp.asarray(1000, jnp.int32)
    y, iterations = solve(blocks, neighbours, jnp.asarray(right), goal, most, coarse, held)
    free = np.repeat(~pinned, 3)
    expected = np.linalg.solve(dense[np.ix_(free, free)], right.ravel()[free])
    assert not np.asarray(y)[pinned].any()
    np.testing.assert_allclose(np.asarray(y).ravel()[free], expected, atol=1e-7 * np.abs(expected).max())
    assert 0 < int(iterations) < 400


def test_block_inverse(x64: None) -> None:
    rng = np.random.default_rng(2)
    factor = rng.normal(size=(50, 3, 3))
    blocks = factor @ factor.transpose(0, 2, 1) + 0.1 * np.eye(3)
    inverse = invert_blocks(jnp.asarray(blocks.transpose(1, 2, 0))).transpose(2, 0, 1)
    np.testing.assert_allclose(inverse, np.linalg.inv(blocks), rtol=1e-8)


def test_float32_reaches_the_solvers_tolerance() -> None:
    blocks, neighbours, dense = random_system(5)
    right = np.random.default_rng(1).normal(size=(len(dense) // 3, 3))
    y, _ = solve(
        jax.tree.map(lambda leaf: leaf.astype(jnp.float32), blocks),
        jnp.asarray(neighbours),
        jnp.asarray(right, jnp.float32),
        jnp.asarray(1e-4, jnp.float32),
        jnp.asarray(500, jnp.int32),
    )
    expected = np.linalg.solve(dense, right.ravel()).reshape(-1, 3)
    assert np.linalg.norm(np.asarray(y) - expected) == pytest.approx(0, abs=2e-3 * np.linalg.norm(expected))
