"""A catalogue is the same however it is cut, and is never begun twice."""

import numpy as np
import pytest

from tests.flat_model import flat_model
from tryon_jax.commands import _catalogue as catalogue
from tryon_jax.commands._catalogue import CatalogueConfig, block_path, catalogue_betas, drape_block, open_catalogue
from tryon_jax.training.dataset import load_arrays
from tryon_jax.training.protocol import EXTENT
from tryon_jax.tryon import save_model


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "flat.safetensors"
    save_model(path, flat_model(target_area=2.5e-3))
    return str(path)


def test_blocks_are_planned_made_and_not_made_again(tmp_path, model_file, monkeypatch):
    config = CatalogueConfig(model_file, garments=2, bodies=5, block=4, seed=3)
    missing = open_catalogue(tmp_path, config)
    assert [task[1:] for task in missing] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    for task in missing:
        assert "vertices" in drape_block(*task)
    assert open_catalogue(tmp_path, config) == []
    blocks = [load_arrays(block_path(*task)) for task in missing]
    mesh = load_arrays(tmp_path / "000000" / "garment.npz")
    assert [len(block["betas"]) for block in blocks] == [4, 1, 4, 1]
    assert blocks[0]["vertices"].shape == (4, len(mesh["mean"]), 3)
    assert mesh["faces"].max() < len(mesh["mean"])
    np.testing.assert_array_equal(blocks[0]["betas"], blocks[2]["betas"])
    # All networks of this model are zero: every body gets the mean drape.
    np.testing.assert_allclose(blocks[1]["vertices"][0], mesh["mean"], atol=1e-5)
    before = block_path(*missing[0]).stat().st_mtime_ns
    assert drape_block(*missing[0]) == ""
    assert block_path(*missing[0]).stat().st_mtime_ns == before


def test_a_garment_does_not_depend_on_the_size_of_the_catalogue(model_file):
    model = catalogue._load(model_file)
    values = [
        np.asarray(catalogue.catalogue_design(model, *which).values) for which in ((0, 7), (0, 7), (1, 7), (0, 8))
    ]
    assert (values[0] == values[1]).all()
    assert (values[0] != values[2]).all()
    assert (values[0] != values[3]).all()
    few, many = catalogue_betas(0, np.arange(3), EXTENT), catalogue_betas(0, np.arange(400), EXTENT)
    np.testing.assert_array_equal(few, many[:3])
    radius = np.linalg.norm(many / np.array(EXTENT), axis=1)
    assert radius.max() <= 1
    # Evenly over the area: half of them beyond 1 / √2.
    assert abs((radius > 2**-0.5).mean() - 0.5) < 0.1


def test_bad_requests_are_named(tmp_path, model_file):
    open_catalogue(tmp_path, CatalogueConfig(model_file, garments=1))
    with pytest.raises(ValueError, match="another catalogue: garments = 1"):
        open_catalogue(tmp_path, CatalogueConfig(model_file, garments=2))
    with pytest.raises(ValueError, match="bodies = 0"):
        open_catalogue(tmp_path, CatalogueConfig(model_file, bodies=0))
    with pytest.raises(ValueError, match="unknown fabric 'silk'"):
        open_catalogue(tmp_path, CatalogueConfig(model_file, fabric="silk"))
