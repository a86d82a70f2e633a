"""One R_fine for every fabric: names and numbers, fields, gradients, files."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.tryon.test_drape_fields import make_model
from tests.tryon.test_tryon import TINY
from tryon_jax.nets.fabric_functions import fit_fabric_functions
from tryon_jax.physics.fabric_numbers import fabric_numbers
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.tryon import (
    ALL_FABRICS,
    Garment,
    TryOnModel,
    apply_fields,
    drape,
    drape_fields,
    init_model,
    load_model,
    prepare,
    save_model,
)
from tryon_jax.tryon.shared_fine import add_shared_fine, save_shared_fine

FABRICS = ("gray-interlock", "royal-target", "white-dots-on-blk")
BETAS = jnp.array([[0.5, -1.0], [1.0, 2.0]])
by_name, by_numbers = jax.jit(drape, static_argnames="fabric"), jax.jit(drape)


@pytest.fixture(scope="module")
def model() -> TryOnModel:
    made = make_model(replace(TINY, fabrics=(), shared_fabrics=FABRICS, fabric_functions=2))
    numbers = np.stack([np.asarray(fabric_numbers(load_fabric(name))) for name in FABRICS])
    values = np.array([[1.0, 0.5], [0.8, -1.0], [1.2, 0.3]])
    stage = replace(made.fine[ALL_FABRICS], fabrics=fit_fabric_functions(numbers, values))
    return replace(made, fine={ALL_FABRICS: stage})


@pytest.fixture(scope="module")
def garment(model: TryOnModel) -> Garment:
    return prepare(model, {"sleeve_length": 0.2})


def test_a_trained_fabric_drapes_the_same_by_name_and_by_numbers(model: TryOnModel, garment: Garment) -> None:
    numbers = fabric_numbers(load_fabric("royal-target"))
    found = by_numbers(model, garment, BETAS, fabric=numbers)
    np.testing.assert_allclose(found, by_name(model, garment, BETAS, fabric="royal-target"), atol=1e-6)
    assert np.abs(found - by_name(model, garment, BETAS)).max() > 1e-5
    np.testing.assert_array_equal(by_name(model, garment, BETAS), by_name(model, garment, BETAS, fabric=FABRICS[0]))


def test_fields_of_any_fabric_are_its_drape(model: TryOnModel, garment: Garment) -> None:
    numbers = fabric_numbers(load_fabric("tango-red-jet-set"))
    fields = jax.jit(drape_fields)(model, garment, fabric=numbers)
    assert np.asarray(fields.fine.fields).shape[-1] == model.config.fields
    expected = by_numbers(model, garment, BETAS, fabric=numbers)
    np.testing.assert_allclose(apply_fields(fields, BETAS), expected, atol=1e-6)


def test_the_drape_is_differentiable_in_the_fabric(model: TryOnModel, garment: Garment) -> None:
    fabric = load_fabric("gray-interlock")
    weight = jax.random.normal(jax.random.key(3), (garment.graph.num_nodes, 3))
    # Untrained networks put cloth deep into the body, where the closest skin jumps.
    model = replace(model, skin=None)

    @jax.jit
    def value(scale: jax.Array) -> jax.Array:
        stiffer = replace(fabric.unnamed, bending=jnp.asarray(fabric.bending) * scale)
        return (drape(model, garment, BETAS[0], fabric_numbers(stiffer)) * weight).sum()

    step = 0.05
    difference = (value(1.0 + step) - value(1.0 - step)) / (2 * step)
    gradient = jax.grad(value)(1.0)
    assert abs(float(gradient)) > 1e-5
    np.testing.assert_allclose(gradient, difference, rtol=0.02)


def test_a_file_keeps_the_functions(model: TryOnModel, garment: Garment, tmp_path: Path) -> None:
    save_model(tmp_path / "fabrics.safetensors", model)
    again = load_model(tmp_path / "fabrics.safetensors")
    assert again.config == model.config
    expected = by_name(model, garment, BETAS, fabric="royal-target")
    np.testing.assert_allclose(by_name(again, garment, BETAS, fabric="royal-target"), expected, atol=1e-6)


def test_the_shared_network_stands_beside_those_of_single_fabrics(
    model: TryOnModel, garment: Garment, tmp_path: Path
) -> None:
    path = tmp_path / "small-fabrics.safetensors"
    save_shared_fine(path, model)
    own = init_model(jax.random.key(5), TINY, body=model.body)
    both = add_shared_fine(replace(own, mean=model.mean, smooth=model.smooth), path)
    assert both.config.known_fabrics == (*TINY.fabrics, "royal-target")
    numbers = fabric_numbers(load_fabric("tango-red-jet-set"))
    for fabric in ("royal-target", numbers):
        run = by_name if isinstance(fabric, str) else by_numbers
        expected = run(model, garment, BETAS, fabric=fabric)
        np.testing.assert_allclose(run(both, garment, BETAS, fabric=fabric), expected, atol=1e-6)
    single = by_name(replace(own, mean=model.mean, smooth=model.smooth), garment, BETAS, fabric=TINY.fabrics[0])
    np.testing.assert_array_equal(by_name(both, garment, BETAS, fabric=TINY.fabrics[0]), single)
    with pytest.raises(ValueError, match="R_mean and R_smooth are not those"):
        add_shared_fine(own, path)
    with pytest.raises(ValueError, match="no R_fine of all fabrics"):
        save_shared_fine(path, own)


def test_what_a_model_does_not_know_is_refused(model: TryOnModel, garment: Garment) -> None:
    with pytest.raises(ValueError, match="fabric 'tango-red-jet-set'"):
        drape(model, garment, BETAS, "tango-red-jet-set")
    with pytest.raises(ValueError, match="takes names, not numbers: 'gray-interlock'"):
        drape(make_model(), garment, BETAS, jnp.zeros(4))
    with pytest.raises(ValueError, match='need conditioning="fields"'):
        init_model(jax.random.key(0), replace(TINY, shared_fabrics=FABRICS, conditioning="node"))
