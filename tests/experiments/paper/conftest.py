"""A data set and a run whose errors are known: the drapes are the model's own predictions, moved by so much."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tests.experiments.known_data import known_model, write_known, write_run
from tryon_jax.tryon import TryOnModel

OFFSETS = {"tshirt-0": 1e-3, "tshirt-100": 2e-3, "unseen-tshirt-0": 0.0}
"""Metres along x between each garment's drapes and the model's predictions."""


class Known(NamedTuple):
    """Where the data and the run lie, and the model."""

    data: Path
    run: Path
    model: TryOnModel


@pytest.fixture(scope="session")
def known(tmp_path_factory: pytest.TempPathFactory) -> Known:
    """Drapes that are the model's predictions moved by `OFFSETS`."""
    folder, model = tmp_path_factory.mktemp("known"), known_model()

    def drapes(name, _fabric, _mean, predicted):
        return predicted.fine + np.array([OFFSETS[name], 0.0, 0.0])

    return Known(write_known(folder / "data", model, drapes), write_run(folder / "run", model), model)
