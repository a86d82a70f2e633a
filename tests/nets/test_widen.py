"""A widened network: the same function, all of whose weights can learn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.graph_meshes import tube
from tryon_jax.body import load_body
from tryon_jax.graph import build_graph
from tryon_jax.nets import UNetConfig, apply_unet, init_unet
from tryon_jax.nets.widen import widen_unet

CONFIG = UNetConfig(widths=(4, 6, 8), decoder_convs=2)
WIDER = (7, 6, 11)


@pytest.fixture(scope="module")
def net():
    # Biases of their own, so that one put in the wrong place is seen.
    net = init_unet(jax.random.key(0), CONFIG, 5)
    keys = iter(jax.random.split(jax.random.key(1), len(jax.tree.leaves(net))))
    return jax.tree.map(lambda leaf: leaf + 0.1 * jax.random.normal(next(keys), leaf.shape), net)


@pytest.fixture(scope="module")
def graph():
    return build_graph(*tube(12, 16), load_body())


def test_the_function_is_the_same(net, graph):
    x = jax.random.normal(jax.random.key(2), (graph.num_nodes, 2, 5))
    wider = widen_unet(jax.random.key(3), net, WIDER)
    assert wider.config.widths == WIDER
    run = jax.jit(apply_unet)
    before, after = run(net, graph.levels, x), run(wider, graph.levels, x)
    assert np.abs(before).max() > 0.1
    np.testing.assert_allclose(after, before, atol=1e-5)


def test_what_was_added_learns(net, graph):
    """A descent step on the widened net moves the old features' view of the new ones; the next reaches all weights."""
    x = jax.random.normal(jax.random.key(2), (graph.num_nodes, 1, 5))
    wider = widen_unet(jax.random.key(3), net, WIDER)

    @jax.jit
    def gradient(net):
        return jax.grad(lambda n: (apply_unet(n, graph.levels, x)[: int(graph.num_vertices)] ** 2).mean())(net)

    first = gradient(wider)
    assert np.abs(first.head.weight[:, CONFIG.widths[0] :]).min() > 0
    moved = jax.tree.map(lambda leaf, slope: leaf - 0.01 * slope, wider, first)
    for leaf in jax.tree.leaves(gradient(moved)):
        assert np.all(np.abs(leaf) > 0)


def test_no_wider_is_the_network_itself(net):
    same = widen_unet(jax.random.key(3), net, CONFIG.widths)
    for leaf, expected in zip(jax.tree.leaves(same), jax.tree.leaves(net), strict=True):
        np.testing.assert_array_equal(leaf, expected)


@pytest.mark.parametrize("widths", [(4, 6), (4, 6, 8, 10), (4, 5, 8)])
def test_other_levels_or_fewer_features_are_refused(net, widths):
    with pytest.raises(ValueError, match=r"widths = .* none smaller than those of \(4, 6, 8\)"):
        widen_unet(jax.random.key(0), net, widths)


def test_a_normalisation_is_refused():
    net = init_unet(jax.random.key(0), UNetConfig(widths=(4,), normalisation="layer"), 5)
    with pytest.raises(ValueError, match="normalisation = 'layer'"):
        widen_unet(jax.random.key(0), net, (6,))


def test_is_seeded(net):
    a, b = (widen_unet(jax.random.key(seed), net, WIDER) for seed in (0, 1))
    again = widen_unet(jax.random.key(0), net, WIDER)
    assert jnp.array_equal(a.head.weight, again.head.weight)
    assert not jnp.array_equal(a.encoder[0][1].weight, b.encoder[0][1].weight)
