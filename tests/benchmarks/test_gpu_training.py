"""What a short run on a GPU trains: stage after stage, stopped, continued, compared with the package's weights."""

import json
from contextlib import nullcontext

import pytest

from benchmarks import _gpu_training
from benchmarks._gpu_training import Training, check_data, load_prepared, train, trained
from experiments.data import pack
from tests.experiments.tiny_garments import FABRIC, tiny_model
from tests.training.made_up_data import NAMES, make_full
from tryon_jax.nets.store import read_record
from tryon_jax.training.dataset import DatasetConfig, open_dataset
from tryon_jax.training.loop import TimeLimits
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import load_model

# Graphs of garments as coarse as these differ in their widest row: one of them is a batch.
STEPS = Training(steps=4, mean_steps=100, garments=1, shapes=2, evaluate_every=2, processes=1)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A packed set, as a GPU's run takes it."""
    root = tmp_path_factory.mktemp("packed")
    pack.main(pack.Config(make_full(tmp_path_factory.mktemp("full")), root))
    return root


@pytest.fixture(autouse=True)
def tiny(monkeypatch, unchecked):
    monkeypatch.setattr(_gpu_training, "network", lambda *_: tiny_model().config)


@pytest.mark.slow
def test_training_is_stopped_by_time_and_continued_to_its_end(data, tmp_path, monkeypatch):
    run = tmp_path / "run"
    monkeypatch.setattr(_gpu_training, "shipped_weights", lambda: nullcontext(model_path(run)))
    check_data(data, run)
    with monkeypatch.context() as short:
        short.setattr(_gpu_training, "TimeLimits", lambda _, every: TimeLimits(-1.0, every))
        found = train(data, run, STEPS, 600.0)
    assert found["state"] == "smooth: time was over at step 1 of 4"
    assert set(found["stages"]) == {"mean"}
    assert found["compared"] == []
    assert trained(run, "smooth") == 0
    check_data(data, run)

    found = train(data, run, STEPS, 600.0)
    assert found["state"] == "all stages have their 4 steps"
    assert {stage: row["step"] for stage, row in found["stages"].items() if stage != "mean"} == {
        "smooth": 4,
        f"fine-{FABRIC}": 4,
    }
    record = read_record(model_path(run))["training"]
    assert {"mean", "smooth", f"fine-{FABRIC}"} <= set(record)
    # The weights beside themselves: as good, no better.
    [line] = found["compared"]
    assert line.startswith(f"{FABRIC}: ")
    assert line.endswith("no better")
    assert len(set(line.replace(":", "").split()) & {word for word in line.split() if "." in word}) == 1
    # Once more: nothing is trained, the record stays.
    assert train(data, run, STEPS, 600.0)["compared"] == [line]
    assert read_record(model_path(run))["training"] == record

    path = run / "smooth" / "record.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"dataset": "0"}))
    with pytest.raises(ValueError, match="was begun with another data set"):
        check_data(data, run)


@pytest.mark.slow
def test_garments_are_prepared_alike_by_many_processes(data, tmp_path):
    train(data, tmp_path, STEPS, 6.0)
    one, two = (load_prepared(data, model_path(tmp_path), NAMES[:2], processes) for processes in (1, 2))
    assert [s.name for s in two] == list(NAMES[:2])
    for a, b in zip(one, two, strict=True):
        assert (a.target == b.target).all()
        assert (a.garment.mean_vertices == b.garment.mean_vertices).all()
    assert load_model(model_path(tmp_path)).config.fabrics == (FABRIC,)


def test_no_time_trains_nothing_and_no_garment_is_refused(tmp_path):
    open_dataset(tmp_path / "data", DatasetConfig(fabrics=(FABRIC,)))
    found = train(tmp_path / "data", tmp_path / "run", STEPS, 2.0)
    assert found["state"] == "not begun: 2 s were left"
    assert not (tmp_path / "run").exists()
    with pytest.raises(ValueError, match="no garment that may be trained on"):
        check_data(tmp_path / "data", tmp_path / "run")
