"""Training R_stance: changes carried back to the T-pose, what is held out, a run on made-up descents."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.experiments.known_data import BETAS, FABRICS, known_model, write_known
from tryon_jax.body import load_body, pose_body, shape_body
from tryon_jax.body.stance import arms_pose
from tryon_jax.garment import load_manifest
from tryon_jax.nets.store import read_record
from tryon_jax.training.dataset import save_arrays
from tryon_jax.training.descents import DescentTask, load_descents
from tryon_jax.training.garments import prepare_simulated
from tryon_jax.training.loop import LoopOptions
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stance_network import HELD_OUT, StanceOptions, carry_back, fit_stance, stance_set, stance_sets
from tryon_jax.tryon import save_model
from tryon_jax.tryon.stance_file import add_stance

VALIDATED = f"{load_manifest().validation[0]}-{load_manifest().training_seeds[0]}"
NAMES = ("tshirt-0", VALIDATED, "unseen-tshirt-0")
DEGREES = np.array([15.0, HELD_OUT, 45.0], np.float32)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drapes that fall a centimetre when the arms are all the way down, and are not skinned along."""
    folder, model = tmp_path_factory.mktemp("data"), known_model()
    write_known(folder, model, lambda _name, _fabric, mean, _: np.repeat(mean[None], len(BETAS), axis=0), NAMES)
    for name in NAMES:
        start = prepare_simulated(model, folder, name).mean_vertices
        for fabric in FABRICS:
            for shape in (0, 2):
                fallen = start[None] - np.array([0.0, 0.01, 0.0]) * (DEGREES / 45.0)[:, None, None]
                arrays = {"betas": BETAS[shape + 1].astype(float), "test": name.startswith("unseen"), "start": start}
                arrays |= {"degrees": DEGREES, "vertices": fallen.astype(np.float32)}
                residual = np.float32([0.01, 0.01, 0.01 if shape else 0.5])
                save_arrays(DescentTask(name, fabric, 0, shape).path(folder), arrays | {"residual": residual})
    return folder


def test_carrying_back_undoes_skinning() -> None:
    body, betas = load_body("female"), np.array([0.5, -1.0])
    skin = np.asarray(shape_body(body, betas.astype(np.float32))[0])
    posed = np.asarray(pose_body(body, betas.astype(np.float32), arms_pose(body, 40.0).astype(np.float32))[0])
    found = carry_back(body, betas, 40.0, posed, np.asarray(body.lbs_weights))
    np.testing.assert_allclose(found, skin, atol=1e-5)


def test_test_garments_held_out_stances_and_cloth_in_motion_are_not_trained_on(root: Path) -> None:
    model, manifest = known_model(), load_manifest()
    sets = stance_sets(model, root, manifest, FABRICS)
    assert sorted({s.name for s in sets}) == sorted(NAMES[:2]), "no garment that is for testing"
    for s in sets:
        chosen = s.validation if s.name == VALIDATED else s.train
        other = s.train if s.name == VALIDATED else s.validation
        assert not other.any()
        assert chosen.sum() == 3, "two bodies at 15 degrees, one at rest at 45"
        np.testing.assert_allclose(np.unique(s.betas[chosen, 2]), [2.0 * 15 / 45, 2.0], rtol=1e-6)
    tested = load_descents(root, NAMES[0], FABRICS[0])
    tested = [replace(descent, test=True) for descent in tested]
    garment = prepare_simulated(model, root, NAMES[0])
    assert not stance_set(model.body, garment, NAMES[0], FABRICS[0], tested, manifest).train.any()


@pytest.mark.slow
def test_a_run_writes_a_network_that_fits_the_model(root: Path, tmp_path: Path, unchecked: None) -> None:
    model = known_model()
    save_model(tmp_path / "model.safetensors", model)
    loop = LoopOptions(steps=2, evaluate_every=2)
    options = StanceOptions(FABRICS, 2, 3, model.config.fine, StageOptions(loop, garments=1, shapes=2))
    with pytest.raises(ValueError, match="no descents to train on"):
        fit_stance([tmp_path], tmp_path / "model.safetensors", tmp_path / "run", options)
    trained = fit_stance([root], tmp_path / "model.safetensors", tmp_path / "run", options)
    record = read_record(tmp_path / "run" / "stance.safetensors")["training"]["stance"]
    assert record["fabrics"] == list(FABRICS)
    assert record["samples"] == 6
    found = add_stance(model, tmp_path / "run" / "stance.safetensors").stance
    assert found is not None
    assert found.config == trained.config
    np.testing.assert_array_equal(found.stage.scale, trained.stage.scale)
