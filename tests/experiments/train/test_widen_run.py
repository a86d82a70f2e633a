"""`experiments widen`: the same drapes from larger networks, in a run of its own."""

from importlib import resources

import jax
import numpy as np
import pytest

from experiments.train.widen import Config, main
from tryon_jax.nets.store import read_record
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import drape, load_model, prepare

pytestmark = pytest.mark.slow

SHIPPED = resources.files("tryon_jax") / "data" / "models" / "small.safetensors"


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    with resources.as_file(SHIPPED) as shipped:
        run = tmp_path_factory.mktemp("widen") / "wide"
        widths = load_model(shipped).config
        config = Config(
            shipped, run, tuple(w + 4 for w in widths.smooth.widths), tuple(w + 2 for w in widths.kriged_fine.widths)
        )
        main(config)
        yield config


def test_drapes_and_the_record_of_training_are_kept(config):
    before, after = load_model(config.model), load_model(model_path(config.run))
    assert (after.config.smooth.widths, after.config.kriged_fine.widths) == (config.smooth, config.fine)
    betas, run = np.array([[1.0, -0.5]], np.float32), jax.jit(drape, static_argnames="fabric")
    narrow, wide = prepare(before, "tank"), prepare(after, "tank")
    for fabric in before.config.fabrics:
        expected = run(before, narrow, betas, fabric=fabric)
        np.testing.assert_allclose(run(after, wide, betas, fabric=fabric), expected, atol=2e-5)
    assert read_record(model_path(config.run))["training"] == read_record(config.model)["training"]


def test_a_run_that_has_begun_is_not_overwritten(config):
    with pytest.raises(FileExistsError, match="begins a run of its own"):
        main(config)
