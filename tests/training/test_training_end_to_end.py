"""From simulation to a trained model on a tiny dataset: the same code, files and guards as the real runs."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest

from tryon_jax.garment.manifest import load_manifest
from tryon_jax.nets.config import load_config
from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.nets.store import read_record
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.training.collision_step import fit_collisions
from tryon_jax.training.collisions import CollisionOptions
from tryon_jax.training.dataset import DatasetConfig, open_dataset
from tryon_jax.training.garments import load_simulated, training_shapes
from tryon_jax.training.generate import run_batch
from tryon_jax.training.kriging_stage import fit_kriging
from tryon_jax.training.loop import LoopOptions
from tryon_jax.training.mean import MeanTraining
from tryon_jax.training.plan import plan
from tryon_jax.training.recipes import fit_fine, fit_mean, fit_smooth, load_fine_sets
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.simulator import Simulator
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_prediction import Predictor, validation_error
from tryon_jax.training.stage_sets import smooth_sets
from tryon_jax.training.training_set import load_samples

pytestmark = pytest.mark.slow

FABRIC = "gray-interlock"
CONFIG = DatasetConfig(fabrics=(FABRIC,), target_area=1.2e-3, dense_vertices=0, reference_vertices=500)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """One T-shirt at coarse triangles, one fabric, two rays of eight shapes."""
    root = tmp_path_factory.mktemp("dataset")
    open_dataset(root, CONFIG)
    for _, wave in plan(CONFIG, load_manifest(), ["tshirt-0"], rays=2):
        for task in wave:
            assert run_batch(str(root), [task])
    return root


@pytest.fixture(scope="module")
def run(dataset, tmp_path_factory, unchecked):
    """R_mean, R_smooth and R_fine, a few steps each."""
    folder = tmp_path_factory.mktemp("run")
    config = replace(
        load_config("small"),
        smooth=UNetConfig(widths=(16, 24, 32)),
        fine=UNetConfig(widths=(16, 24)),
        kriged_fine=UNetConfig(widths=(12, 16)),
        fabrics=(FABRIC,),
        target_area=1.2e-3,
        num_levels=3,
    )
    fit_mean(dataset, folder, config, MeanTraining(steps=300))
    options = StageOptions(LoopOptions(steps=120, learning_rate=4e-3, evaluate_every=60), garments=1, shapes=4)
    fit_smooth(dataset, folder, options)
    fit_fine(dataset, folder, [FABRIC], replace(options, loop=replace(options.loop, steps=40, evaluate_every=20)))
    return folder


def test_the_papers_input_and_energies_are_options(dataset, run, tmp_path):
    from tryon_jax.tryon import load_model

    (tmp_path / "model.safetensors").write_bytes(model_path(run).read_bytes())
    loop = LoopOptions(steps=2, evaluate_every=2)
    options = StageOptions(loop, garments=1, shapes=4, fine_input="smoothed", energy=0.1)
    fit_fine(dataset, tmp_path, [FABRIC], options)
    record = read_record(model_path(tmp_path))["training"][f"fine-{FABRIC}"]
    assert record["options"]["energy"] == 0.1
    assert np.isfinite(record["validation_mm"])
    assert len(record["curve"]) == 1
    # A run that starts from a trained model says what that was trained on; finished once more it says the same.
    earlier = read_record(model_path(run))["training"][f"fine-{FABRIC}"]
    assert record["continues"] == earlier
    fit_fine(dataset, tmp_path, [FABRIC], options)
    assert read_record(model_path(tmp_path))["training"][f"fine-{FABRIC}"]["continues"] == earlier
    before, after = load_model(model_path(run)).fine[FABRIC], load_model(model_path(tmp_path)).fine[FABRIC]
    assert not np.array_equal(before.net.head.weight, after.net.head.weight)


def test_r_fine_learns_what_kriging_leaves(dataset, run, tmp_path, unchecked):
    from tryon_jax.tryon import load_model

    (tmp_path / "model.safetensors").write_bytes(model_path(run).read_bytes())
    loop = LoopOptions(steps=4, evaluate_every=4)
    fit_smooth(dataset, tmp_path, StageOptions(loop, garments=1, shapes=4))
    smooth = read_record(model_path(tmp_path))["training"]["smooth"]
    fit_kriging(dataset, tmp_path, [FABRIC], KrigingConfig(designs=6, shapes=5, functions=20, components=6))
    kriged = read_record(model_path(tmp_path))["training"][f"kriging-{FABRIC}"]
    assert kriged["garments"] == 1
    assert kriged["samples"] > 5
    assert kriged["validation_mm"] < 20
    before = load_model(model_path(tmp_path))
    assert before.fine[FABRIC].net.config.widths == (12, 16)
    fit_fine(dataset, tmp_path, [FABRIC], StageOptions(loop, garments=1, shapes=4))
    record = read_record(model_path(tmp_path))["training"][f"fine-{FABRIC}"]
    assert record["options"]["design_dropout"] == 0
    assert record["samples"] == kriged["samples"]
    fit_collisions(tmp_path, [FABRIC], CollisionOptions(loop, pool=2, held_out=1, shapes=4), dataset)
    # What is done already takes no time, though the model has kriged drapes now.
    fit_smooth(dataset, tmp_path, StageOptions(loop, garments=1, shapes=4))
    assert read_record(model_path(tmp_path))["training"]["smooth"] == smooth
    after = load_model(model_path(tmp_path))
    kept = zip(jax.tree.leaves(after.kriging[FABRIC]), jax.tree.leaves(before.kriging[FABRIC]), strict=True)
    assert all(np.array_equal(one, other) for one, other in kept)
    assert not np.array_equal(after.fine[FABRIC].net.head.weight, before.fine[FABRIC].net.head.weight)
    with pytest.raises(ValueError, match="which was carried over"):
        fit_fine(dataset, tmp_path, [FABRIC], StageOptions(loop, garments=1, shapes=4, fresh=1))


def test_fresh_topologies_are_trained_on_and_have_no_energy(dataset, run, tmp_path):
    (tmp_path / "model.safetensors").write_bytes(model_path(run).read_bytes())
    options = StageOptions(LoopOptions(steps=2, evaluate_every=2), garments=1, shapes=4, fresh=1)
    fit_smooth(dataset, tmp_path, options)
    record = read_record(model_path(tmp_path))["training"]["smooth"]
    assert record["garments"] == 2
    assert record["samples"] == 2 * record["continues"]["samples"]
    assert record["options"]["fresh"] == 1
    assert record["continues"]["options"]["fresh"] == 0
    with pytest.raises(ValueError, match=r"energy = 0\.1 needs fresh = 0, not 1"):
        fit_fine(dataset, tmp_path, [FABRIC], replace(options, energy=0.1))


def test_the_collision_step_may_replay_simulated_drapes(dataset, run, tmp_path, unchecked):
    from tryon_jax.tryon import load_model

    (tmp_path / "model.safetensors").write_bytes(model_path(run).read_bytes())
    loop = LoopOptions(steps=6, evaluate_every=6)
    options = CollisionOptions(loop, pool=2, held_out=1, shapes=4, replay=0.0)
    for bad, message in ((0.5, "replay = 0.5 needs the folder of a dataset"), (1.0, "replay = 1 is outside")):
        with pytest.raises(ValueError, match=message):
            fit_collisions(tmp_path, [FABRIC], replace(options, replay=bad))
    fit_collisions(tmp_path, [FABRIC], options)
    first = read_record(model_path(tmp_path))["training"][f"collisions-{FABRIC}"]
    assert {"dataset", "continues"}.isdisjoint(first)
    assert first["options"]["replay"] == 0
    (tmp_path / f"collisions-{FABRIC}").rename(tmp_path / "first")
    # Steps that only see simulated drapes, or nearly so, bring the network nearer to them.
    loop = LoopOptions(steps=40, learning_rate=2e-3, evaluate_every=40)
    fit_collisions(tmp_path, [FABRIC], replace(options, loop=loop, replay=0.9, anchor=0.0), dataset)
    second = read_record(model_path(tmp_path))["training"][f"collisions-{FABRIC}"]
    assert second["options"]["replay"] == 0.9
    assert second["dataset"] == read_record(model_path(run))["training"][f"fine-{FABRIC}"]["dataset"]
    assert second["continues"] == first
    # Asked for once more it is done already, and its record stays.
    fit_collisions(tmp_path, [FABRIC], replace(options, loop=loop, replay=0.9, anchor=0.0), dataset)
    assert read_record(model_path(tmp_path))["training"][f"collisions-{FABRIC}"] == second
    assert second["inside_training_percent"][0] == pytest.approx(first["inside_training_percent"][1])
    before, after = load_model(model_path(run)), load_model(model_path(tmp_path))
    sets, _ = load_fine_sets(before, dataset, FABRIC, StageOptions())
    predictor = Predictor(before.config, "fine")
    # Of the drapes that were replayed: on others forty steps may go either way.
    seen = [replace(s, validation=s.train) for s in sets]
    errors = [validation_error(predictor, m.fine[FABRIC], seen) for m in (before, after)]
    assert errors[1] < errors[0]
    # R_fine trained once more has not been through a collision step.
    fit_fine(dataset, tmp_path, [FABRIC], StageOptions(LoopOptions(steps=2, evaluate_every=2), garments=1, shapes=4))
    assert f"collisions-{FABRIC}" not in read_record(model_path(tmp_path))["training"]


def test_tasks_are_done_once(dataset):
    waves = plan(CONFIG, load_manifest(), ["tshirt-0"], 2)
    assert all(run_batch(str(dataset), [task]) == "" for _, wave in waves for task in wave)


def test_training_improves_on_doing_nothing(dataset, run):
    from tryon_jax.tryon import load_model

    model = load_model(model_path(run))
    samples = load_samples(model, dataset, ["tshirt-0"])
    [samples_set] = smooth_sets(samples, load_manifest())
    nothing = np.asarray(samples_set.garment.graph.vertices)[None]
    mask = np.asarray(samples_set.garment.graph.mask)
    predictor = Predictor(model.config, "smooth")
    for shapes, share in ((samples_set.train, 0.5), (samples_set.validation, 0.8)):
        assert shapes.any()
        error = validation_error(predictor, model.smooth, [replace(samples_set, validation=shapes)])
        before = 1e3 * np.linalg.norm((samples_set.targets - nothing)[:, mask][shapes], axis=-1).mean()
        assert error < share * before


def test_record_says_how_it_was_trained(run):
    training = read_record(model_path(run))["training"]
    assert {"mean", "smooth", f"fine-{FABRIC}"} <= set(training)
    assert training["smooth"]["steps"] == 120
    assert json.loads((run / "smooth" / "record.json").read_text())["stage"] == "smooth"


def test_test_shapes_are_marked_and_never_trained_on(dataset, run):
    from tryon_jax.tryon import load_model

    [samples] = load_samples(load_model(model_path(run)), dataset, ["tshirt-0"])
    allowed = training_shapes(samples, load_manifest())
    assert samples.test.sum() == 8
    assert not (allowed & samples.test).any()


def test_test_garments_are_refused(dataset, run):
    from tryon_jax.tryon import load_model

    Simulator(dataset).garment("tshirt-100")
    samples = load_simulated(load_model(model_path(run)), dataset, "tshirt-0", [FABRIC])
    with pytest.raises(PermissionError, match="tshirt-100 is a test garment"):
        training_shapes(replace(samples, name="tshirt-100"), load_manifest())
