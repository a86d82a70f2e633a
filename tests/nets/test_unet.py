"""Graph U-Net: independent of padding and of vertex order, differentiable, seeded."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from jax.test_util import check_grads

from tests.graph_meshes import tube
from tryon_jax.body import load_body
from tryon_jax.graph import apply_operator, build_graph, stack_graphs
from tryon_jax.nets import PAPER, SMALL, UNetConfig, apply_unet, count_parameters, init_unet, load_config
from tryon_jax.nets.unet import layer_norm

run = jax.jit(apply_unet)
CONFIG = UNetConfig(widths=(6, 8, 10), order=3, activation="tanh")


def features_of(graph, samples=2, seed=0):
    x = np.random.default_rng(seed).normal(size=(graph.num_nodes, samples, 5)).astype(np.float32)
    x[int(graph.num_vertices) :] = 0.0
    return jnp.asarray(x)


@pytest.fixture(scope="module")
def net():
    return init_unet(jax.random.key(0), CONFIG, 5)


@pytest.mark.parametrize("pooling", ["average", "select"])
def test_same_result_and_gradient_in_every_bucket(net, pooling):
    body = load_body()
    results, gradients = [], []
    for bucket in (512, 1024):
        graph = build_graph(*tube(16, 20), body, bucket=bucket, pooling=pooling)
        x = jnp.zeros((bucket, 2, 5)).at[:320].set(features_of(graph)[:320])

        def loss(net, x, levels):
            y = apply_unet(net, levels, x)[:320]
            return (y**2).sum(), y

        compiled = jax.jit(jax.value_and_grad(loss, argnums=(0, 1), has_aux=True))
        (_, y), gradient = compiled(net, x, graph.levels)
        results.append(np.asarray(y))
        gradients.append(gradient)
    for y, (to_net, to_x) in zip(results[1:], gradients[1:], strict=True):
        np.testing.assert_allclose(y, results[0], atol=1e-6)
        np.testing.assert_allclose(to_x[:320], gradients[0][1][:320], atol=1e-5)
        for a, b in zip(jax.tree.leaves(to_net), jax.tree.leaves(gradients[0][0]), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-4)


def test_values_at_padded_nodes_influence_nothing(net):
    graph = build_graph(*tube(16, 20), load_body())
    x = features_of(graph)
    y = run(net, graph.levels, x)[:320]
    z = run(net, graph.levels, x.at[320:].set(1e3))[:320]
    np.testing.assert_array_equal(y, z)


def test_batch_of_garments_equals_one_by_one(net):
    body = load_body()
    graphs = [build_graph(*tube(16, 20, seed=s), body) for s in range(3)]
    x = jnp.stack([features_of(g, seed=i) for i, g in enumerate(graphs)])
    many = jax.jit(jax.vmap(apply_unet, in_axes=(None, 0, 0)))(net, stack_graphs(graphs).levels, x)
    for i, graph in enumerate(graphs):
        np.testing.assert_allclose(many[i], run(net, graph.levels, x[i]), atol=1e-6)


def test_gradient_against_finite_differences(x64):
    graph = build_graph(*tube(5, 5), load_body(), dtype=np.float64)
    net = init_unet(jax.random.key(1), UNetConfig(widths=(3, 4), order=2, activation="silu"), 2)
    flat, unflatten = ravel_pytree(jax.tree.map(lambda a: jnp.asarray(a, jnp.float64), net))
    x = jnp.asarray(np.random.default_rng(0).normal(size=(graph.num_nodes, 1, 2)))

    @jax.jit
    def f(flat, x):
        return apply_unet(unflatten(jnp.asarray(flat)), graph.levels, jnp.asarray(x))[:25]

    check_grads(f, (flat, x), order=1, modes=("fwd", "rev"), atol=1e-5, rtol=1e-5)


def test_layer_norm_forgets_scale_and_offset_and_a_normalised_network_is_finite_on_padding():
    x = jnp.asarray(np.random.default_rng(2).normal(size=(7, 2, 16)), jnp.float32)
    normal = layer_norm(x)
    np.testing.assert_allclose(normal.mean(-1), 0.0, atol=1e-6)
    np.testing.assert_allclose((normal**2).mean(-1), 1.0, atol=1e-4)
    np.testing.assert_allclose(layer_norm(3.0 * x + 2.0), normal, atol=1e-4)
    graph = build_graph(*tube(16, 20), load_body())
    net = init_unet(jax.random.key(0), UNetConfig(widths=(8, 8), normalisation="layer"), 5)
    assert np.isfinite(run(net, graph.levels, jnp.zeros((graph.num_nodes, 1, 5)))).all()
    with pytest.raises(ValueError, match="normalisation"):
        UNetConfig(normalisation="batch")


def test_down_then_up_keeps_constants():
    graph = build_graph(*tube(16, 20), load_body())
    ones = jnp.ones((graph.num_nodes, 1))
    for level in graph.levels[:-1]:
        count = int(np.sum(level.mask))
        ones = apply_operator(level.down, ones)
        back = apply_operator(level.up, ones)
        np.testing.assert_allclose(back[:count], 1.0, atol=1e-6)
        assert not np.asarray(back[count:]).any()


def test_same_key_same_network_other_key_other_network(net):
    again, other = init_unet(jax.random.key(0), CONFIG, 5), init_unet(jax.random.key(1), CONFIG, 5)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(net), jax.tree.leaves(again), strict=True))
    assert not np.array_equal(net.head.weight, other.head.weight)


def test_paper_configuration_weighs_at_most_71_megabytes_and_smooth_is_deeper():
    def count(config):
        smooth = jax.eval_shape(lambda: jax.tree.leaves(init_unet(jax.random.key(0), config.smooth, 29)))
        fine = jax.eval_shape(lambda: jax.tree.leaves(init_unet(jax.random.key(0), config.fine, config.fine_features)))
        return count_parameters(smooth), count_parameters(fine)

    smooth, fine = count(PAPER)
    assert 0.9 * 71e6 < 4 * (smooth + fine) <= 71e6
    assert len(PAPER.smooth.widths) > len(PAPER.fine.widths)
    assert len(SMALL.smooth.widths) > len(SMALL.fine.widths)
    assert sum(count(SMALL)) < 1_500_000


def test_bad_configurations_are_named(net):
    with pytest.raises(ValueError, match="did you mean 'tanh'"):
        UNetConfig(activation="tan")
    with pytest.raises(ValueError, match="Chebyshev order = 0"):
        UNetConfig(order=0)
    with pytest.raises(ValueError, match="unknown configuration 'papers'"):
        load_config("papers")
    graph = build_graph(*tube(5, 5), load_body(), num_levels=2)
    with pytest.raises(ValueError, match="pools to 3 levels"):
        apply_unet(net, graph.levels, features_of(graph))
