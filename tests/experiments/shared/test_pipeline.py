"""Predictions of the experiments: with kriged drapes, and as for a mesh without a design."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from experiments.shared.evaluate import Pipeline
from tests.experiments.known_data import FABRICS, known_model
from tests.tryon.test_kriged_drape import random_drapes
from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.tryon import TryOnModel, drape, init_model, prepare

BETAS = np.array([[0.5, -1.0], [0.0, 0.0]], np.float32)


@pytest.fixture(scope="module")
def model() -> TryOnModel:
    plain = known_model()
    config = replace(
        plain.config,
        kriging=KrigingConfig(designs=6, shapes=5, functions=20, components=4),
        kriged_fine=UNetConfig(widths=(5,)),
        shared_fabrics=FABRICS[:1],
    )
    made = replace(init_model(jax.random.key(1), config, body=plain.body), mean=plain.mean)
    return replace(made, kriging={f: random_drapes(made, k, i) for i, (f, k) in enumerate(made.kriging.items())})


def test_predictions_are_drapes(model: TryOnModel) -> None:
    samples: Any = SimpleNamespace(garment=prepare(model), betas=BETAS)
    garment, rows = samples.garment, np.arange(2)
    pipeline = Pipeline(model)
    found = pipeline(samples, rows, FABRICS)
    raw = Pipeline(replace(model, skin=None))(samples, rows, FABRICS)
    for fabric in FABRICS:
        plain = drape(replace(model, skin=None), garment, BETAS, fabric)
        np.testing.assert_allclose(raw[fabric].fine, garment.unpad(plain), atol=2e-6)
        # Corrections have thresholds: the last digit of a vertex may decide whether it is near enough to the skin.
        corrected = drape(model, garment, BETAS, fabric)
        np.testing.assert_allclose(found[fabric].fine, garment.unpad(corrected), atol=2e-4)
        assert np.abs(found[fabric].fine - raw[fabric].fine).max() > 2e-3
        # R_fine has not been trained: it adds next to nothing.
        kriged = pipeline.kriged(model.kriging[fabric], samples, rows)
        moved = np.abs(kriged - garment.mean_vertices[None]).max()
        assert moved > 0.01
        assert np.abs(raw[fabric].fine - kriged).max() < 0.1 * moved
    bare = prepare(model, mesh=(garment.mean_vertices, garment.faces))
    expected = bare.unpad(drape(model, bare, BETAS, FABRICS[0]))
    without = pipeline.without_design(samples, rows, FABRICS[0])
    assert without is not None
    assert without.shape == expected.shape
    assert pipeline.without_design(samples, rows, FABRICS[1]) is None
    # The mesh alone has no pattern to build its hierarchy from, but the same networks drape it.
    np.testing.assert_allclose(without.mean(axis=1), expected.mean(axis=1), atol=5e-3)
