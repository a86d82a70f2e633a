"""Coefficients from the drapes: the span is found, missing drapes are no harm, and shapes between are met."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.nets.config import load_config
from tryon_jax.nets.mlp import init_mlp
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.training.principal import (
    principal_coefficients,
    principal_functions,
    spread_over_shapes,
)
from tryon_jax.training.stage_sets import StageSet
from tryon_jax.tryon import init_model, prepare
from tryon_jax.tryon.stages import field_coefficients


def residual(functions: np.ndarray, values: np.ndarray) -> float:
    """Share of `values` outside the span of `functions`."""
    fitted = functions @ np.linalg.lstsq(functions, values, rcond=None)[0]
    return float(np.linalg.norm(values - fitted) / np.linalg.norm(values))


def test_functions_span_the_drapes_and_are_ordered() -> None:
    rng = np.random.default_rng(0)
    drapes = rng.normal(size=(40, 3)) @ np.diag([5.0, 2.0, 0.5]) @ rng.normal(size=(3, 300))
    functions = principal_functions(drapes, np.ones(drapes.shape, bool), 3)
    assert residual(functions, drapes) < 1e-6
    sizes = np.sqrt((functions**2).mean(axis=0))
    assert np.all(np.diff(sizes) < 0)
    gram = functions.T @ functions
    np.testing.assert_allclose(gram, np.diag(np.diag(gram)), atol=1e-6)
    assert np.mean(functions**2) == pytest.approx(1.0)


def test_missing_drapes_are_filled_in() -> None:
    rng = np.random.default_rng(1)
    drapes = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 300))
    known = np.repeat(rng.random((40, 30)) > 0.2, 10, axis=1)
    functions = principal_functions(np.where(known, drapes, np.nan), known, 3)
    assert residual(functions, drapes) < 1e-3


def test_more_functions_than_shapes_are_zero() -> None:
    functions = principal_functions(np.eye(4, 30), np.ones((4, 30), bool), 6)
    assert functions.shape == (4, 6)
    assert not functions[:, 4:].any()


@pytest.mark.parametrize("width", [1, 2])
def test_values_at_other_shapes(width: int) -> None:
    rng = np.random.default_rng(2)
    known = rng.uniform(-1, 1, (60, width))
    wanted = rng.uniform(-0.8, 0.8, (20, width))

    def smooth(points):
        return np.column_stack([points.sum(axis=1), np.sin(points).prod(axis=1)])

    np.testing.assert_allclose(spread_over_shapes(known, smooth(known), wanted), smooth(wanted), atol=0.03)
    on_a_line = np.repeat(known[:, :1], width, axis=1)
    assert np.isfinite(spread_over_shapes(on_a_line, smooth(known), wanted)).all()


@pytest.mark.slow
def test_perceptron_gives_drapes_at_shapes_that_were_not_simulated() -> None:
    net = UNetConfig(widths=(4, 4), encoder_convs=1)
    config = load_config("small", smooth=net, fine=net, fields=3)
    model = init_model(jax.random.key(0), config)
    garment = prepare(model, "tshirt", target_area=3e-3)
    count = garment.graph.num_nodes
    rng = np.random.default_rng(3)
    fields = rng.normal(size=(3, count, 3)).astype(np.float32)
    angle, radius = np.meshgrid(np.arange(8) * np.pi / 4, np.linspace(0.25, 1.0, 4), indexing="ij")
    betas = np.column_stack([(3 * radius * np.cos(angle)).ravel(), (2 * radius * np.sin(angle)).ravel()])

    def weights(b):
        return np.column_stack([b[:, 0], b[:, 1], 0.3 * b[:, 0] * b[:, 1]])

    base = np.asarray(garment.graph.vertices)
    drapes = (base[None] + 0.01 * np.einsum("sk,knc->snc", weights(betas), fields)).astype(np.float32)
    every = np.ones(len(betas), bool)
    config = replace(config, reference="paper")
    one = StageSet("tshirt-0", garment, betas.astype(np.float32), None, drapes, every, ~every)
    # A garment with few drapes says nothing, and does no harm.
    few = replace(one, train=np.arange(len(betas)) < 3)
    start = init_mlp(jax.random.key(1), (2 * (1 + 2 * len(config.beta_periods)), 32, 3))
    mlp = principal_coefficients(config, replace(model.smooth, coefficients=start), [one, few], 0)
    others = np.array([[1.0, 0.5], [-1.2, -1.1], [0.3, 1.4], [2.0, -0.4]], np.float32)
    mlp = jax.tree.map(jnp.asarray, mlp)
    found = np.asarray(field_coefficients(mlp, jnp.asarray(others), config.beta_scale, config.beta_periods))
    basis = np.asarray(field_coefficients(mlp, jnp.asarray(one.betas), config.beta_scale, config.beta_periods))
    onto = np.linalg.lstsq(basis, weights(betas), rcond=None)[0]
    np.testing.assert_allclose(found @ onto, weights(others), atol=0.06)


def test_a_stage_in_the_papers_form_has_none() -> None:
    net = UNetConfig(widths=(4, 4), encoder_convs=1)
    config = load_config("small-node", smooth=net, fine=net)
    model = init_model(jax.random.key(0), config)
    with pytest.raises(ValueError, match="fields"):
        principal_coefficients(config, model.smooth, [], 0)
