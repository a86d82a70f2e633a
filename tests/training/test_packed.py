"""Packed data sets: what comes back, how near it is, and that training does not notice."""

from pathlib import Path

import numpy as np
import pytest

from experiments.data import pack
from tests.experiments.tiny_garments import FABRIC, tiny_model
from tests.training.made_up_data import MANIFEST, NAMES, make_full
from tryon_jax.training.dataset import load_arrays
from tryon_jax.training.drapes import has_drapes, load_drapes, load_mesh
from tryon_jax.training.garments import load_simulated
from tryon_jax.training.mean import load_templates
from tryon_jax.training.packed import Drapes, pack_garment, packed_path, read_packed_drapes
from tryon_jax.training.recipes import load_fine_sets
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_prediction import Predictor, validation_error
from tryon_jax.training.training_set import dataset_checksum, training_names


@pytest.fixture(scope="module")
def full(tmp_path_factory) -> Path:
    return make_full(tmp_path_factory.mktemp("full"))


@pytest.fixture(scope="module")
def packed(full, tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("packed")
    pack.main(pack.Config(full, root))
    return root


def test_no_drape_is_moved_by_more_than_was_asked_for(full, packed):
    size = sum(path.stat().st_size for path in packed.rglob("*.npz"))
    assert size < 0.35 * sum(path.stat().st_size for path in full.rglob("*.npz"))
    for name in NAMES:
        before, after = load_drapes(full, name, FABRIC), load_drapes(packed, name, FABRIC)
        np.testing.assert_array_equal(after.betas, before.betas)
        for part in ("test", "good", "resting"):
            np.testing.assert_array_equal(getattr(after, part), getattr(before, part))
        assert before.good.sum() < len(before.good) - 1
        kept = before.good | before.resting
        assert before.test[kept].any()
        off = np.linalg.norm(after.vertices - before.vertices, axis=2).mean(axis=1)
        assert 1e-4 < off[kept].max() <= 3e-4
        assert not after.vertices[~kept].any()


def test_the_mesh_comes_back(full, packed):
    for name in NAMES:
        before, after = load_mesh(full, name), load_mesh(packed, name)
        assert set(after) == set(before)
        for key, values in before.items():
            assert after[key].dtype == values.dtype
            np.testing.assert_allclose(after[key], values, atol=2e-7)
        # Which vertices are pooled together hangs on the last digit of where they start.
        for key in ("faces", "faces_uv", "template_vertices", "start", "uv"):
            np.testing.assert_array_equal(after[key], before[key])


def test_training_reads_the_packed_set_as_the_full_one(full, packed, unchecked):
    model = tiny_model()
    names = training_names(full, MANIFEST)
    assert training_names(packed, MANIFEST) == names == list(NAMES[:3])
    one, other = (load_simulated(model, root, NAMES[0], [FABRIC]) for root in (full, packed))
    np.testing.assert_array_equal(other.usable, one.usable)
    np.testing.assert_array_equal(other.betas, one.betas)
    mask = np.asarray(one.garment.graph.mask)
    near = np.linalg.norm((other.target - one.target)[one.usable][:, mask], axis=2)
    assert near.mean() < 3e-4
    errors = []
    for root in (full, packed):
        sets, _ = load_fine_sets(model, root, FABRIC, StageOptions())
        assert any(s.validation.any() for s in sets)
        errors.append(validation_error(Predictor(model.config, "fine"), model.fine[FABRIC], sets))
    assert errors[0] > 1.0
    assert errors[1] == pytest.approx(errors[0], abs=0.05)
    templates = [load_templates(root, MANIFEST).templates for root in (full, packed)]
    np.testing.assert_allclose(templates[1], templates[0], atol=1e-6)
    assert dataset_checksum(packed, names) != dataset_checksum(full, names)


def test_additional_designs_are_left_out_the_last_first(full, tmp_path, capsys):
    pack.main(pack.Config(full, tmp_path / "all"))
    assert "4 garments" in capsys.readouterr().out
    sizes = {name: packed_path(tmp_path / "all", name).stat().st_size + 600 for name in NAMES}
    templates = sum(path.stat().st_size for path in (tmp_path / "all" / "templates").glob("*"))
    enough = 1e-6 * (templates + sum(sizes.values()) - 10)
    # What an earlier packing left in the folder goes too.
    pack.main(pack.Config(full, tmp_path / "all", max_megabytes=enough))
    said = capsys.readouterr().out
    assert "left out for their size: 1 additional designs, from additional-7-0 on" in said
    assert {path.stem for path in (tmp_path / "all" / "packed").glob("*")} == set(NAMES) - {"additional-7-0"}
    small = 1e-6 * (templates + sizes["tshirt-0"] + 10)
    with pytest.raises(ValueError, match="tshirt-100 is needed too"):
        pack.main(pack.Config(full, tmp_path / "few", max_megabytes=small))


def test_what_cannot_be_packed_is_refused(full, packed, tmp_path):
    with pytest.raises(ValueError, match="is a packed set already"):
        pack.main(pack.Config(packed, tmp_path / "again"))
    with pytest.raises(ValueError, match="max_error"):
        pack.main(pack.Config(full, tmp_path / "out", max_error=0.0))
    with pytest.raises(FileNotFoundError, match="no drapes in denim"):
        load_drapes(packed, NAMES[0], "denim")
    assert not has_drapes(packed, "vest-0", [FABRIC])


def test_a_smaller_error_takes_finer_steps(full, tmp_path):
    mesh, drapes = load_mesh(full, NAMES[0]), load_drapes(full, NAMES[0], FABRIC)
    rough, fine = (pack_garment(tmp_path / f"{e}.npz", mesh, {FABRIC: drapes}, e)[FABRIC] for e in (1e-3, 5e-5))
    assert fine.step < 0.2 * rough.step
    assert fine.worst_mm <= 0.05 < rough.worst_mm <= 1.0
    assert fine.modes >= rough.modes
    assert fine.worst_test_mm <= fine.worst_mm <= fine.largest_mm
    assert load_arrays(tmp_path / "5e-05.npz")[f"{FABRIC}:coefficients"].dtype == np.float16


def test_a_single_drape_and_none_at_all(full, tmp_path):
    mesh, drapes = load_mesh(full, NAMES[0]), load_drapes(full, NAMES[0], FABRIC)
    for count in (1, 0):
        kept = np.arange(len(drapes.betas)) < count
        few = Drapes(drapes.betas, drapes.vertices, drapes.test, kept, kept)
        reached = pack_garment(tmp_path / "x.npz", mesh, {FABRIC: few})[FABRIC]
        assert reached.drapes == count
        back = read_packed_drapes(tmp_path / "x.npz", FABRIC)
        off = np.linalg.norm(back.vertices[:count] - drapes.vertices[:count], axis=2)
        assert off.mean() <= 3e-4 if count else not back.vertices.any()
