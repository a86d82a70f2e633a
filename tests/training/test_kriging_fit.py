"""Fitting kriged drapes: reading at nodes, leaving designs out, and what may not be fitted."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.experiments.tiny_garments import AREA, FABRIC
from tests.training.made_up_data import MANIFEST, make_full
from tryon_jax.nets.config import load_config
from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.kriging import STEP, WEIGHT_STEP, KrigingFit, kriged_starts, kriging_error, principal_components
from tryon_jax.training.node_drapes import NodeReader, read_nodes
from tryon_jax.training.stage_sets import split_validation
from tryon_jax.training.training_set import load_samples
from tryon_jax.tryon import TryOnModel, init_model

CONFIG = KrigingConfig(designs=8, shapes=12, functions=60, components=12)
NAMES = ("tshirt-0", "additional-3-0", "additional-7-0")


@pytest.fixture(scope="module")
def model() -> TryOnModel:
    net = UNetConfig(widths=(4, 4))
    config = load_config("small", smooth=net, fine=net, fabrics=(FABRIC,), target_area=AREA, num_levels=2)
    return init_model(jax.random.key(0), config)


@pytest.fixture(scope="module")
def samples(model: TryOnModel, tmp_path_factory: pytest.TempPathFactory) -> list[SimulatedGarment]:
    return load_samples(model, make_full(tmp_path_factory.mktemp("data")), NAMES)


def test_values_at_nodes_are_found_from_those_at_vertices(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    reader, garment = NodeReader(model), samples[0].garment
    assert reader.num_nodes == CONFIG.nodes
    # Fields that are smooth over the template, as drapes are.
    rng = np.random.default_rng(0)
    mean = garment.mean_vertices
    fields = np.sin(mean @ rng.normal(size=(3, 3)) * 8)[None] * np.array([1.0, 2.0])[:, None, None]
    found = reader(garment, fields.astype(np.float32))
    operator = reader.operator(garment)
    back = np.stack([operator @ field for field in found])
    assert np.abs(back - fields).mean() < 0.03 * np.abs(fields).mean()
    np.testing.assert_allclose(operator.sum(axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize("columns", [30, 300])
def test_principal_components_are_those_of_the_singular_values(columns: int) -> None:
    rows = np.random.default_rng(0).normal(size=(40, columns)).astype(np.float32)
    basis = principal_components(rows, 6)
    expected = np.linalg.svd(rows, full_matrices=False)[2][:6].T
    np.testing.assert_allclose(np.abs(np.sum(basis * expected, axis=0)), 1.0, atol=1e-4)
    # Drapes that are all alike have none.
    assert not principal_components(np.zeros_like(rows), 6).any()


def test_leaving_drapes_out_is_fitting_without_them(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    fit = KrigingFit(read_nodes(model, samples, MANIFEST, FABRIC), CONFIG)
    rows = fit.rows["additional-7-0"]
    found = fit.without(rows)
    functions, coordinates = fit.functions, fit.coordinates
    kept = np.setdiff1d(np.arange(len(functions)), rows)
    normal = functions[kept].T @ functions[kept] + np.diag(fit.ridge)
    weights = np.linalg.solve(normal, functions[kept].T @ coordinates[kept])
    components = np.asarray(fit.kriging.components).reshape(CONFIG.components, -1)
    spread = np.sqrt((coordinates**2).mean(axis=0))
    expected = (functions[rows] @ weights / spread[None]) @ components + np.asarray(fit.kriging.mean).ravel()
    # The process that is kept is rounded to hundredths of a millimetre.
    np.testing.assert_allclose(found.reshape(len(rows), -1), expected, atol=2e-4)
    assert np.abs(found.reshape(len(rows), -1) - expected).mean() < 2e-5
    assert np.abs(found).max() > 1e-3


def test_what_is_kept_is_rounded_and_predicts_the_same(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    drapes = read_nodes(model, samples, MANIFEST, FABRIC)
    fit = KrigingFit(drapes, CONFIG)
    components, weights = (np.asarray(a, np.float64) for a in (fit.kriging.components, fit.kriging.weights))
    np.testing.assert_array_equal(components / STEP, np.rint(components / STEP))
    # Each column of weights has a step of its own, a power of two; the trend's are kept as they are.
    moved = np.linalg.norm(components, axis=2).mean(axis=1)
    for column, size in zip(weights[: CONFIG.functions].T, moved, strict=True):
        step = next(s for s in 2.0 ** np.arange(4, -30, -1) if not np.any(column % s))
        assert step * size > WEIGHT_STEP / 4
    assert np.any(weights[CONFIG.functions :] % 2.0**-9)
    kept = np.asarray(fit.kriging.mean)[None] + np.einsum("sf,fr,rqc->sqc", fit.functions, weights, components)
    off = np.linalg.norm(kept.reshape(len(kept), -1, 3) - fit.predict(drapes).reshape(len(kept), -1, 3), axis=2)
    assert off.mean() < 1e-4


def test_starts_leave_the_own_design_out(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    fit = KrigingFit(read_nodes(model, samples, MANIFEST, FABRIC), CONFIG)
    starts = kriged_starts(model, fit.kriging, fit.without_each_design(), samples, MANIFEST, FABRIC)
    for s, start in zip(samples, starts, strict=True):
        assert start.shape == s.drapes[FABRIC].shape
        count = s.garment.num_vertices
        train, validation = (mask & s.good[FABRIC] for mask in split_validation(s, MANIFEST))
        off = {
            name: np.linalg.norm((start - s.drapes[FABRIC])[rows, :count], axis=2).mean()
            for name, rows in (("train", train), ("validation", validation))
        }
        # The design's own drapes tell more of its validation shapes than other designs tell of it.
        assert off["validation"] < off["train"]


def test_some_garments_can_be_chosen(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    every = read_nodes(model, samples, MANIFEST, FABRIC)
    some = every.only(["additional-7-0", "tshirt-0"])
    assert list(some.rows) == ["tshirt-0", "additional-7-0"]
    for name, rows in some.rows.items():
        np.testing.assert_array_equal(some.fields[rows], every.fields[every.rows[name]])
        np.testing.assert_array_equal(some.shapes[rows], every.shapes[every.rows[name]])


def test_the_error_is_the_distance_on_validation_shapes(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    fit = KrigingFit(read_nodes(model, samples, MANIFEST, FABRIC), CONFIG)
    nothing = replace(fit.kriging, weights=np.zeros_like(fit.kriging.weights))
    errors = [kriging_error(model, kriging, samples, MANIFEST, FABRIC) for kriging in (fit.kriging, nothing)]
    assert errors[0] < 0.5 * errors[1]


def test_drapes_at_rest_are_fitted_good_or_not(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    train = split_validation(samples[0], MANIFEST)[0]
    good = samples[0].good[FABRIC].copy()
    good[np.flatnonzero(train)[:3]] = False
    s = replace(samples[0], good={FABRIC: good})
    rested = train & s.resting[FABRIC]
    assert (rested & ~good).any()
    assert len(read_nodes(model, [s], MANIFEST, FABRIC).fields) == rested.sum()
    assert s.drapes[FABRIC][rested].any(axis=(1, 2)).all()
    assert not s.drapes[FABRIC][~good & ~s.resting[FABRIC]].any()
    held = read_nodes(model, [s], MANIFEST, FABRIC, "validation")
    assert len(held.fields) == (split_validation(s, MANIFEST)[1] & good).sum()


def test_other_drapes_are_predicted(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    fitted = read_nodes(model, samples, MANIFEST, FABRIC)
    held = read_nodes(model, samples, MANIFEST, FABRIC, "validation")
    assert not {tuple(row) for row in held.shapes.tolist()} & {tuple(row) for row in fitted.shapes.tolist()}
    predicted = KrigingFit(fitted, CONFIG).predict(held)
    assert np.abs(predicted - held.fields).mean() < 0.3 * np.abs(held.fields - fitted.fields.mean(axis=0)).mean()


def test_few_drapes_leave_components_empty(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    config = replace(CONFIG, components=400)
    kriging = KrigingFit(read_nodes(model, samples[:1], MANIFEST, FABRIC), config).kriging
    assert np.asarray(kriging.components).shape[0] == 400
    assert not np.asarray(kriging.components)[-1].any()


def test_test_garments_and_carried_ones_are_refused(model: TryOnModel, samples: list[SimulatedGarment]) -> None:
    with pytest.raises(PermissionError, match="tshirt-100 is a test garment"):
        read_nodes(model, [replace(samples[0], name="tshirt-100")], MANIFEST, FABRIC)
    with pytest.raises(ValueError, match="not to 'tshirt-0', which was carried over"):
        read_nodes(model, [replace(samples[0], source="dress-0")], MANIFEST, FABRIC)
    bad = replace(samples[0], resting={FABRIC: np.zeros_like(samples[0].test)})
    with pytest.raises(ValueError, match="at least one drape at rest"):
        read_nodes(model, [bad], MANIFEST, FABRIC)
