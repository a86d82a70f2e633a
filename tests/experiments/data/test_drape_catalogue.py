"""Random catalogues: a garment and a body are the same however many there are."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from experiments.data import drape_catalogue
from experiments.data.drape_catalogue import Config, main, random_betas, random_design
from tests.flat_model import flat_model
from tryon_jax.commands import catalogue
from tryon_jax.training.dataset import load_arrays
from tryon_jax.training.protocol import EXTENT
from tryon_jax.tryon import save_model


def test_a_garment_and_a_body_do_not_depend_on_the_size_of_the_catalogue():
    model = flat_model()
    values = [np.asarray(random_design(model, *which).values) for which in ((0, 7), (0, 7), (1, 7), (0, 8))]
    assert (values[0] == values[1]).all()
    assert (values[0] != values[2]).all()
    assert (values[0] != values[3]).all()
    few, many = random_betas(0, np.arange(3), EXTENT), random_betas(0, np.arange(400), EXTENT)
    np.testing.assert_array_equal(few, many[:3])
    radius = np.linalg.norm(many / np.array(EXTENT), axis=1)
    assert radius.max() <= 1
    # Evenly over the area: half of them beyond 1 / √2.
    assert abs((radius > 2**-0.5).mean() - 0.5) < 0.1


def test_the_lists_are_draped_as_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(catalogue, "open_pool", lambda *_: ThreadPoolExecutor(1))
    weights = tmp_path / "flat.safetensors"
    model = flat_model(target_area=2.5e-3)
    save_model(weights, model)
    main(Config(tmp_path / "out", garments=2, bodies=3, seed=3, weights=weights))
    block = load_arrays(tmp_path / "out" / "000001" / "00000.npz")
    np.testing.assert_array_equal(
        block["betas"], drape_catalogue.random_betas(3, np.arange(3), model.config.beta_ranges)
    )
    assert "000001/00000.npz" in (tmp_path / "out" / "checksums.txt").read_text()
