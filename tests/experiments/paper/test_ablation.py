"""Ablation: variants see what they say and no test sample, numbers add up, records of other options are not read."""

import json
from dataclasses import replace

import numpy as np
import pytest

from experiments.paper.ablation import _read, block_ratio, draw, markdown, summarise
from experiments.paper.variants import (
    BLOCK,
    VARIANTS,
    along_first,
    in_block,
    measure_variant,
    restrict,
    train_variant,
    variant_config,
    variant_garments,
    without_weights,
)
from tests.experiments.tiny_garments import FABRIC, stretched, tiny_model
from tryon_jax.garment import load_manifest
from tryon_jax.nets.config import SMALL
from tryon_jax.training.loop import LoopOptions
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_sets import StageSet

pytestmark = pytest.mark.usefixtures("unchecked")


def test_every_variant_differs_from_the_base_in_one_thing():
    base = VARIANTS["base"]
    for name, variant in VARIANTS.items():
        changed = [k for k, v in vars(variant).items() if k != "title" and v != vars(base)[k]]
        # One network in place of two can only learn a displacement from M̄ itself; with betas at each node every body
        # costs a pass, and fewer make a step as long as the others'.
        assert len(changed) == (0 if name == "base" else 2 if name in ("one-stage", "node") else 1), name
    assert variant_config(base, SMALL) == SMALL
    assert variant_config(VARIANTS["order-3"], SMALL).fine.order == 3
    assert len(variant_config(VARIANTS["no-pooling"], SMALL).smooth.widths) == 1


def test_garments_of_variants():
    manifest = load_manifest()
    names = manifest.training_garments()
    of = {name: variant_garments(variant, names, manifest) for name, variant in VARIANTS.items()}
    for chosen in of.values():
        assert all(manifest.split(n.rsplit("-", 1)[0], int(n.rsplit("-", 1)[1])) == "training" for n in chosen)
    fitted = {k: [n for n in v if n.rsplit("-", 1)[0] not in manifest.validation] for k, v in of.items()}
    assert len(fitted["base"]) == 2 * len(manifest.training)
    assert len(fitted["half-designs"]) == 2 * 10
    assert len(fitted["quarter-designs"]) == 2 * 5
    assert len(fitted["more-designs"]) == len(manifest.training_garments()) - len(manifest.validation)


def test_block_and_first_beta():
    low, high = np.array(BLOCK).T
    middle = 0.5 * (low + high)
    betas = np.array([middle, low - 0.1, high + 0.1, [2.0, 0.0], [-2.0, 0.1], [0.0, 0.0], [0.0, 1.0]])
    np.testing.assert_array_equal(in_block(betas)[:3], [True, False, False])
    np.testing.assert_array_equal(along_first(betas)[3:], [True, True, True, False])


def test_restricted_sets_keep_a_sample_to_choose_by():
    train, validation = np.array([True, True, True, False, False]), np.array([False, False, False, True, False])
    whole = StageSet("a", None, np.zeros((5, 2)), None, np.zeros((5, 1, 3)), train, validation)  # type: ignore[arg-type]
    assert restrict(np.ones(5, bool), whole) is whole
    some = restrict(np.array([True, True, True, False, True]), whole)
    np.testing.assert_array_equal(some.train, [True, False, True, False, False])
    np.testing.assert_array_equal(some.validation, [False, True, False, False, False])
    assert not (some.train & some.validation).any()


def samples_mm(values, betas=((-0.5, 1.0), (2.0, 0.0), (0.0, -2.0))):
    return {
        "as trained": [{"name": "a", "betas": betas, "fine_mm": values, "smooth_mm": [9.0] * 3, "folds": [0.5, 0.25]}],
        "unseen design": [],
    }


def test_means_over_parts_of_the_range():
    found = summarise(samples_mm([6.0, 3.0, 12.0]))
    assert set(found) == {"as trained"}
    assert found["as trained"] == {
        "mean_mm": 7.0,
        "block_mm": 6.0,
        "outside_block_mm": 7.5,
        "first_beta_mm": 3.0,
        "ends_mm": 12.0,
        "smooth_mm": 9.0,
        "samples": 3,
        "folds": 0.5,
        "correlation": 0.25,
    }


def results(held):
    def variant(name, values):
        counts = {"parameters": 10, "garments": 2, "samples": 30, "seconds": 60.0}
        return {"title": VARIANTS[name].title, **counts, "errors": summarise(samples_mm(values))}

    variants = {"base": variant("base", [6.0, 3.0, 12.0]), "one-beta": variant("one-beta", [6.0, 2.0, 40.0])}
    variants["held-out-block"] = variant("held-out-block", [held, 3.0, 12.0])
    baselines = {"transfer": {"title": "moved", "errors": summarise(samples_mm([20.0] * 3))}}
    return {"fabric": FABRIC, "block": BLOCK, "variants": variants, "baselines": baselines}


@pytest.mark.parametrize(("held", "verdict"), [(9.0, "reached (1.12)"), (18.0, "not reached (1.64)")])
def test_the_held_out_block_against_the_mean(held, verdict, tmp_path):
    found = results(held)
    lines = markdown(found)
    assert lines[-1].endswith(f"the mean: {verdict}.")
    assert "2.00 mm trained along it alone, 3.00 mm trained on both" in "\n".join(lines)
    assert block_ratio({"variants": {}}) is None
    draw(tmp_path / "ablation.png", found)
    assert (tmp_path / "ablation.png").exists()


def test_records_of_other_options_are_not_read(tmp_path):
    path = tmp_path / "result.json"
    assert _read(path, {"a": 1}) is None
    path.write_text(json.dumps({"identity": {"a": [1, 2]}, "x": 1}))
    assert _read(path, {"a": (1, 2)}) is not None
    assert _read(path, {"a": (1, 3)}) is None


@pytest.mark.slow
def test_a_variant_is_trained_and_measured_and_continues(tmp_path):
    model, manifest = tiny_model(), load_manifest()
    samples = stretched(model)
    assert not np.asarray(without_weights(samples).garment.graph.skinning_weights).any()
    variant = replace(VARIANTS["held-out-block"], skinning_weights=False, loss={"edges": 1.0, "normals": 1.0})
    options = StageOptions(LoopOptions(steps=30, learning_rate=1e-2, evaluate_every=10), garments=1, shapes=4)
    arguments = (variant, model, [samples], manifest, FABRIC, tmp_path, tmp_path, options, 10, "toy")
    trained, record = train_variant(*arguments)
    assert record["smooth"]["steps"] == 30
    assert record["fine"]["steps"] == 10
    assert record["samples"] <= int((~samples.test & ~in_block(samples.betas)).sum())
    found = measure_variant(variant, trained, {"as trained": [samples], "unseen design": []}, FABRIC, 2)
    [entry] = found["as trained"]
    assert found["unseen design"] == []
    assert len(entry["betas"]) == len(entry["fine_mm"]) >= 2
    assert len(entry["folds"]) == 2
    tested = samples.betas[samples.test].tolist()
    assert all(beta in tested for beta in entry["betas"])
    again, _ = train_variant(*arguments)
    np.testing.assert_array_equal(again.smooth.net.head.weight, trained.smooth.net.head.weight)
