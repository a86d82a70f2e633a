"""The model in the wheel: it is the promise of the library, so its drapes are checked as drapes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tryon_jax as tj
from tools.ship_weights import (
    DESIGNS,
    TORN,
    bodies_all_over_the_range,
    fabrics_of,
    largest_strain,
    random_tears,
)
from tryon_jax.contact.closest_points import closest_points
from tryon_jax.contact.surface import build_surface
from tryon_jax.tryon import config_space

EXTREMES = ("navy-sparkle-sweat", "royal-target")
"""The fabrics that give most and least: shipping looks at all ten."""


@pytest.fixture(scope="module")
def model() -> tj.TryOnModel:
    return tj.load_pretrained()


def test_unknown_name_is_refused():
    with pytest.raises(ValueError, match="unknown pretrained model 'smal'"):
        tj.load_pretrained("smal")


def test_drapes_hang_on_the_body(model):
    """Near the skin and hardly inside it, on shapes in all directions."""
    garment = tj.prepare(model, "tshirt")
    drape = jax.jit(tj.drape, static_argnames="fabric")
    betas = jnp.array([[0.0, 0.0], [2.0, 0.0], [-2.0, 0.0], [0.0, 1.3], [0.0, -1.3], [1.4, 1.0], [-1.4, -1.0]])
    for fabric in model.config.fabrics:
        vertices = garment.unpad(drape(model, garment, betas, fabric=fabric))
        for row, shape in zip(vertices, betas, strict=True):
            skin, _ = tj.shape_body(model.body, shape)
            distance = np.asarray(closest_points(build_surface(skin, model.body.faces), row).height)
            assert np.median(distance) < 0.06
            assert (distance < -0.005).mean() < 0.01
            assert (distance < 0).mean() < 0.04


@pytest.mark.parametrize("design", DESIGNS)
def test_no_drape_is_torn_anywhere_in_the_range_of_bodies(model, design):
    """Mean errors do not show a collar that collapses on one body; edges do, on shapes all over the range."""
    bodies, fabrics = bodies_all_over_the_range(), fabrics_of(model, EXTREMES)
    tear = largest_strain(model, config_space(model.config).preset(design), 0, bodies, fabrics)
    assert tear.strain < TORN, tear.where


def test_random_designs_in_random_topologies_on_random_bodies_are_not_torn(model):
    for tear in random_tears(model, 4, seed=5, fabrics=fabrics_of(model, EXTREMES)):
        assert tear.strain < TORN, tear.where


def test_garments_follow_the_body(model):
    """A taller body wears the same T-shirt higher above its pelvis, by centimetres."""
    garment = tj.prepare(model, "tshirt")
    drape = jax.jit(tj.drape, static_argnames="fabric")
    low, high = (garment.unpad(drape(model, garment, jnp.array([b, 0.0]))) for b in (-2.0, 2.0))
    assert high[:, 1].max() - low[:, 1].max() > 0.04


def test_the_papers_form_comes_beside_it():
    """Betas at each node, no fields, trained on the same designs; its drapes hang on the body too."""
    rival = tj.load_pretrained("paper-form")
    assert rival.config.conditioning == "node"
    garment = tj.prepare(rival, "tshirt")
    vertices = garment.unpad(tj.drape(rival, garment, jnp.array([1.0, 0.5])))
    skin, _ = tj.shape_body(rival.body, jnp.array([1.0, 0.5]))
    distance = np.asarray(closest_points(build_surface(skin, rival.body.faces), vertices).height)
    assert np.median(distance) < 0.06
    assert (distance < -0.005).mean() < 0.02
    with pytest.raises(ValueError, match="no fields"):
        tj.drape_fields(rival, garment)


def test_the_network_of_all_fabrics_drapes_those_that_it_never_saw(model):
    """They hang on the body, and knitted cloth hangs elsewhere than stiff woven cloth, by millimetres."""
    garment, betas = tj.prepare(model, "tshirt"), jnp.array([1.0, 0.5])
    drape = jax.jit(tj.drape)
    skin, _ = tj.shape_body(model.body, betas)
    drapes = {}
    for fabric in ("ivory-rib-knit", "tango-red-jet-set", "royal-target"):
        numbers = tj.fabric_numbers(tj.load_fabric(fabric))
        drapes[fabric] = garment.unpad(drape(model, garment, betas, fabric=numbers))
        distance = np.asarray(closest_points(build_surface(skin, model.body.faces), drapes[fabric]).height)
        assert np.median(distance) < 0.06
        assert (distance < -0.005).mean() < 0.01
    assert {"ivory-rib-knit", "tango-red-jet-set"}.isdisjoint(model.config.shared_fabrics)
    apart = np.linalg.norm(drapes["ivory-rib-knit"] - drapes["royal-target"], axis=1).mean()
    assert 0.004 < apart < 0.05


def test_record_tells_how_it_was_trained(model):
    from importlib import resources

    from tryon_jax.nets.store import read_record

    record = read_record(resources.files("tryon_jax") / "data" / "models" / "small.safetensors")
    assert {"mean", "smooth"} <= set(record["training"])
    assert all(f"fine-{fabric}" in record["training"] for fabric in model.config.fabrics)
