"""The model in the wheel: it is the promise of the library, so its drapes are checked as drapes."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tryon_jax as tj
from tools.ship_weights import (
    DESIGNS,
    TORN,
    bodies_all_over_the_range,
    drape_bodies,
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


@pytest.fixture(scope="module")
def session(model) -> tj.Session:
    """All designs padded to one size, so that few programs drape them."""
    return tj.Session(model, one_size=True)


def tshirt(session: tj.Session, betas: Sequence[Sequence[float]], fabric: str | np.ndarray) -> np.ndarray:
    """A T-shirt on some bodies."""
    garment = session.prepare("tshirt").garment
    return garment.unpad(drape_bodies(session.model, garment, np.asarray(betas, np.float32), fabric))


def test_unknown_name_is_refused():
    with pytest.raises(ValueError, match="unknown pretrained model 'smal'"):
        tj.load_pretrained("smal")


@pytest.mark.slow
def test_drapes_hang_on_the_body(model, session):
    """Near the skin and hardly inside it, on shapes in all directions."""
    betas = [[0.0, 0.0], [2.0, 0.0], [-2.0, 0.0], [0.0, 1.3], [0.0, -1.3], [1.4, 1.0], [-1.4, -1.0]]
    for fabric in model.config.fabrics:
        for row, shape in zip(tshirt(session, betas, fabric), betas, strict=True):
            skin, _ = tj.shape_body(model.body, jnp.array(shape))
            distance = np.asarray(closest_points(build_surface(skin, model.body.faces), row).height)
            assert np.median(distance) < 0.06
            assert (distance < -0.005).mean() < 0.01
            assert (distance < 0).mean() < 0.04


@pytest.mark.slow
@pytest.mark.parametrize("design", DESIGNS)
def test_no_drape_is_torn_anywhere_in_the_range_of_bodies(model, session, design):
    """Mean errors do not show a collar that collapses on one body; edges do, on shapes all over the range."""
    bodies, fabrics = bodies_all_over_the_range(), fabrics_of(model, EXTREMES)
    tear = largest_strain(session, config_space(model.config).preset(design), 0, bodies, fabrics)
    assert tear.strain < TORN, tear.where


@pytest.mark.slow
def test_random_designs_in_random_topologies_on_random_bodies_are_not_torn(model, session):
    for tear in random_tears(session, 4, seed=5, fabrics=fabrics_of(model, EXTREMES)):
        assert tear.strain < TORN, tear.where


@pytest.mark.slow
def test_garments_follow_the_body(model, session):
    """A taller body wears the same T-shirt higher above its pelvis, by centimetres."""
    low, high = tshirt(session, [[-2.0, 0.0], [2.0, 0.0]], model.config.fabrics[0])
    assert high[:, 1].max() - low[:, 1].max() > 0.04


@pytest.mark.slow
def test_the_papers_form_comes_beside_it():
    """Betas at each node, no fields, trained on the same designs; its drapes hang on the body too."""
    rival = tj.load_pretrained("paper-form")
    assert rival.config.conditioning == "node"
    garment = tj.prepare(rival, "tshirt")
    vertices = garment.unpad(jax.jit(tj.drape)(rival, garment, jnp.array([1.0, 0.5])))
    skin, _ = tj.shape_body(rival.body, jnp.array([1.0, 0.5]))
    distance = np.asarray(closest_points(build_surface(skin, rival.body.faces), vertices).height)
    assert np.median(distance) < 0.06
    assert (distance < -0.005).mean() < 0.02
    with pytest.raises(ValueError, match="no fields"):
        tj.drape_fields(rival, garment)


@pytest.mark.slow
def test_the_network_of_all_fabrics_drapes_those_that_it_never_saw(model, session):
    """They hang on the body, and knitted cloth hangs elsewhere than stiff woven cloth, by millimetres."""
    skin, _ = tj.shape_body(model.body, jnp.array([1.0, 0.5]))
    drapes = {}
    for fabric in ("ivory-rib-knit", "tango-red-jet-set", "royal-target"):
        numbers = np.asarray(tj.fabric_numbers(tj.load_fabric(fabric)))
        [drapes[fabric]] = tshirt(session, [[1.0, 0.5]], numbers)
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
