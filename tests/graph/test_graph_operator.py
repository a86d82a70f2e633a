"""The one sparse product: equal to the matrix, differentiable in every mode, foldable by vmap."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.experimental.sparse import BCOO
from jax.test_util import check_grads

from tryon_jax.graph import apply_operator, make_operator
from tryon_jax.graph import operator as graph_operator

# Compiled as a whole: op by op, each of the shapes that hypothesis draws would take dozens of programs.
execute_in_one = jax.jit(graph_operator._execute_in_one)
join_lists = jax.jit(graph_operator._join_lists, static_argnums=(1, 2))


def random_matrix(rows, columns, density, seed):
    return sp.csr_array(sp.random_array((rows, columns), density=density, rng=np.random.default_rng(seed)))


@settings(max_examples=10)
@given(st.integers(1, 40), st.integers(1, 40), st.floats(0.0, 0.6), st.integers(0, 99))
def test_product_and_adjoint_equal_the_matrix_whatever_the_capacities(rows, columns, density, seed):
    matrix = random_matrix(rows, columns, density, seed)
    operator = make_operator(matrix, (rows + 3, columns + 2), slots=3, transposed_slots=2)
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(columns + 2, 2, 3)), rng.normal(size=(rows + 3, 2, 3))
    forward = np.asarray(apply_operator(operator, jnp.asarray(x, jnp.float32)))
    backward = np.asarray(apply_operator(operator.transpose, jnp.asarray(y, jnp.float32)))
    dense = matrix.toarray()
    np.testing.assert_allclose(forward[:rows], np.einsum("mn,nbc->mbc", dense, x[:columns]), atol=2e-5)
    np.testing.assert_allclose(backward[:columns], np.einsum("mn,mbc->nbc", dense, y[:rows]), atol=2e-5)
    # Padding gives nothing and takes nothing.
    assert not forward[rows:].any()
    assert not backward[columns:].any()
    # Adjoint: ⟨A x, y⟩ = ⟨x, Aᵀ y⟩.
    assert (forward * y).sum() == pytest.approx((x * backward).sum(), abs=1e-3)


@settings(max_examples=10)
@given(st.integers(1, 24), st.integers(1, 24), st.floats(0.0, 0.6), st.integers(0, 99))
def test_the_way_of_other_devices_gives_the_same(rows, columns, density, seed):
    """What is lowered for a GPU, executed here: one operator, and two that `vmap` joins."""

    def run(operator, x):
        leaves = [*jax.tree.leaves(operator.rows), *jax.tree.leaves(operator.columns)]
        return execute_in_one(*leaves, x)

    pair = [
        make_operator(random_matrix(rows, columns, density, seed + k), slots=3, tail=(24, 24), transposed_slots=2)
        for k in range(2)
    ]
    x = np.random.default_rng(seed).normal(size=(2, columns, 5)).astype(np.float32)
    expected = [np.asarray(apply_operator(operator, features)) for operator, features in zip(pair, x, strict=True)]
    np.testing.assert_allclose(run(pair[0], x[0]), expected[0], atol=2e-5)
    lists = [np.stack(leaves) for leaves in zip(*(jax.tree.leaves(operator.rows) for operator in pair), strict=True)]
    joined = join_lists(lists, rows, columns)
    both = execute_in_one(*joined, *joined, x.reshape(-1, 5))
    np.testing.assert_allclose(both.reshape(2, rows, 5), expected, atol=2e-5)


@settings(max_examples=8)
@given(st.integers(2, 30), st.floats(0.05, 0.9), st.integers(0, 99))
def test_symmetric_operator_is_its_own_transpose(size, density, seed):
    half = random_matrix(size, size, density, seed)
    matrix = sp.csr_array(half + half.T)
    operator = make_operator(matrix, slots=4)
    assert operator.transpose is operator
    x = np.random.default_rng(seed).normal(size=(size, 2)).astype(np.float32)
    np.testing.assert_allclose(apply_operator(operator, jnp.asarray(x)), matrix @ x, atol=1e-4)


def test_bcoo_goes_in_and_comes_out_sorted_and_unique(x64):
    matrix = random_matrix(20, 30, 0.3, 0)
    given_matrix = BCOO.from_scipy_sparse(sp.coo_matrix(matrix))
    operator = make_operator(given_matrix, (24, 32), slots=4, transposed_slots=4, dtype=np.float64)
    returned = operator.to_bcoo()
    assert returned.indices_sorted
    assert returned.unique_indices
    assert len(np.unique(np.asarray(returned.indices), axis=0)) == len(returned.indices)
    np.testing.assert_allclose(returned.todense()[:20, :30], matrix.toarray())
    x = jnp.asarray(np.random.default_rng(1).normal(size=(32, 3)))
    np.testing.assert_allclose(apply_operator(operator, x), apply_operator(returned, x), atol=1e-12)


@pytest.mark.parametrize("symmetric", [True, False])
def test_derivatives_in_every_mode(x64, symmetric):
    matrix = random_matrix(12, 12, 0.4, 3)
    if symmetric:
        operator = make_operator(sp.csr_array(matrix + matrix.T), slots=3, dtype=np.float64)
    else:
        operator = make_operator(matrix, slots=3, transposed_slots=3, dtype=np.float64)
    x = jnp.asarray(np.random.default_rng(0).normal(size=(12, 2)))

    def f(x):
        return jnp.sin(apply_operator(operator, jnp.asarray(x) ** 2))

    check_grads(f, (x,), order=2, modes=("fwd", "rev"))
    linear, push = jax.linearize(f, x)
    np.testing.assert_allclose(push(x), jax.jvp(f, (x,), (x,))[1], atol=1e-12)
    np.testing.assert_allclose(linear, f(x))


def test_vmap_over_features_over_operators_and_over_both():
    matrices = [random_matrix(9, 7, 0.5, seed) for seed in range(3)]
    operators = [make_operator(m, slots=2, tail=(9, 8), transposed_slots=2, transposed_tail=(9, 8)) for m in matrices]
    stacked = jax.tree.map(lambda *a: np.stack(a), *operators)
    x = jnp.asarray(np.random.default_rng(0).normal(size=(3, 7, 4)), jnp.float32)
    expected = np.stack([np.stack([m @ x[i] for i in range(3)]) for m in matrices])
    many = jax.vmap(jax.vmap(apply_operator, in_axes=(None, 0)), in_axes=(0, None))(stacked, x)
    np.testing.assert_allclose(many, expected, atol=1e-5)
    both = jax.vmap(apply_operator)(stacked, x)
    np.testing.assert_allclose(both, np.stack([expected[i, i] for i in range(3)]), atol=1e-5)
    only = jax.vmap(apply_operator, in_axes=(0, None))(stacked, x[0])
    np.testing.assert_allclose(only, expected[:, 0], atol=1e-5)
    last = jax.vmap(apply_operator, in_axes=(None, 2), out_axes=2)(operators[0], x.transpose(1, 2, 0))
    np.testing.assert_allclose(last, expected[0].transpose(1, 2, 0), atol=1e-5)
    pulled = jax.grad(lambda x: (jax.vmap(apply_operator)(stacked, x) ** 2).sum())(x)
    hand = np.stack([2 * m.T @ (m @ x[i]) for i, m in enumerate(matrices)])
    np.testing.assert_allclose(pulled, hand, atol=1e-4)


def test_entries_are_constants_of_differentiation():
    operator = make_operator(random_matrix(6, 6, 0.5, 0), slots=2, transposed_slots=2)

    def product(weights):
        changed = dataclasses.replace(operator, rows=dataclasses.replace(operator.rows, weights=weights))
        return apply_operator(changed, jnp.ones((6, 1))).sum()

    assert not np.asarray(jax.grad(product)(jnp.asarray(operator.rows.weights))).any()


def test_faults_are_named():
    matrix = random_matrix(4, 5, 0.5, 0)
    with pytest.raises(ValueError, match=r"\(4, 5\) does not fit"):
        make_operator(matrix, (4, 4), transposed_slots=1)
    with pytest.raises(ValueError, match="not square"):
        make_operator(matrix)
