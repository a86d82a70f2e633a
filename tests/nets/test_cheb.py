"""Chebyshev convolution against its spectral definition and against a dense formula."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.graph_meshes import disc, join, tube
from tryon_jax.graph import make_operator
from tryon_jax.graph.laplacian import scaled_laplacian
from tryon_jax.mesh.topology import unique_edges
from tryon_jax.nets import ChebConv, cheb_conv, init_cheb_conv


@pytest.fixture(scope="module")
def graph():
    vertices, faces = join(disc(60), tube(6, 5))
    scaled, _ = scaled_laplacian(unique_edges(faces, len(vertices))[0], len(vertices), "symmetric")
    return scaled, make_operator(scaled, (128, 128), slots=7, dtype=np.float64)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6])
@pytest.mark.parametrize(("inputs", "outputs"), [(3, 5), (5, 3), (4, 4)])
def test_equals_the_spectral_filter(x64, graph, order, inputs, outputs):
    scaled, operator = graph
    n = scaled.shape[0]
    rng = np.random.default_rng(order)
    params = ChebConv(rng.normal(size=(order, inputs, outputs)), rng.normal(size=outputs))
    x = np.zeros((128, 2, inputs))
    x[:n] = rng.normal(size=(n, 2, inputs))
    # U T_k(Λ) Uᵀ with T_k(λ) = cos(k arccos λ).
    values, vectors = np.linalg.eigh(scaled.toarray())
    expected = np.zeros((n, 2, outputs)) + params.bias
    for k in range(order):
        filtered = np.einsum("nm,m,lm,lbi->nbi", vectors, np.cos(k * np.arccos(np.clip(values, -1, 1))), vectors, x[:n])
        expected += filtered @ params.weight[k]
    result = np.asarray(cheb_conv(params, operator, jnp.asarray(x)))
    np.testing.assert_allclose(result[:n], expected, atol=1e-9)


def test_order_of_the_vertices_does_not_matter(x64, graph):
    scaled, operator = graph
    n = scaled.shape[0]
    rng = np.random.default_rng(0)
    order = rng.permutation(n)
    moved = make_operator(scaled[order][:, order], (128, 128), slots=7, dtype=np.float64)
    params = init_cheb_conv(jax.random.key(0), 3, 2, 4)
    x = np.zeros((128, 1, 2))
    x[:n] = rng.normal(size=(n, 1, 2))
    y = x.copy()
    y[:n] = x[:n][order]
    first = np.asarray(cheb_conv(params, operator, jnp.asarray(x)))[:n]
    second = np.asarray(cheb_conv(params, moved, jnp.asarray(y)))[:n]
    np.testing.assert_allclose(second, first[order], atol=1e-12)


def test_initial_size_keeps_the_variance():
    params = init_cheb_conv(jax.random.key(1), 2, 200, 300)
    assert float(jnp.std(params.weight)) == pytest.approx((2 / 400) ** 0.5, rel=0.02)
    assert not np.asarray(params.bias).any()
