"""Networks in bfloat16 inside a drape in float32."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from tryon_jax.graph import build_graph
from tryon_jax.graph.smoothing import make_smoother
from tryon_jax.nets.config import load_config
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.tryon import Garment, apply_stage, drape, init_model, smooth_features
from tryon_jax.tryon.precision import cast_net, with_precision


def test_half_precision_networks_give_nearly_the_same_float32():
    net = UNetConfig(widths=(6,), encoder_convs=1)
    config = load_config("small", smooth=net, fine=net, num_levels=1)
    model = init_model(jax.random.key(0), config)
    rng = np.random.default_rng(0)
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 12, endpoint=False), np.linspace(-0.1, 0.3, 9))
    points = np.stack([0.2 * np.cos(angle), height, 0.2 * np.sin(angle)], axis=-1).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(8), np.arange(12), indexing="ij")
    a, b = row * 12 + column, row * 12 + (column + 1) % 12
    faces = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, b, a + 12), (b, b + 12, a + 12))])
    graph = build_graph(points, faces, model.body, num_levels=1)
    garment = Garment(graph, make_smoother(points, faces, config.smoothing_length, graph.num_nodes))
    betas = jnp.asarray(rng.normal(size=(2, config.num_betas)), jnp.float32)
    half = with_precision(model)
    assert {leaf.dtype for leaf in jax.tree.leaves((half.smooth.net, half.fine))} >= {jnp.dtype(jnp.bfloat16)}
    assert half.smooth.scale.dtype == jnp.float32
    both = [drape(m, garment, betas) for m in (model, half)]
    assert both[1].dtype == jnp.float32
    # Displacements here are about 0.01 m: eight bits of them are 0.04 mm.
    moved = np.abs(np.asarray(both[0]) - np.asarray(garment.graph.vertices)).max()
    apart = np.abs(np.asarray(both[0] - both[1])).max()
    assert 0 < apart < 0.05 * moved

    def loss(net, dtype):
        stage = replace(model.smooth, net=cast_net(net, dtype))
        return (apply_stage(stage, graph, smooth_features(config, garment, betas)) ** 2).sum()

    exact, rough = (jax.grad(loss)(model.smooth.net, dtype) for dtype in (jnp.float32, jnp.bfloat16))
    for one, other in zip(jax.tree.leaves(exact), jax.tree.leaves(rough), strict=True):
        assert other.dtype == jnp.float32
        assert np.linalg.norm(one - other) <= 0.05 * np.linalg.norm(one)
