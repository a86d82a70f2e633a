"""Errors over fabrics where the drapes are the model's own: none when it is told the fabric, some when it is not."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.beyond import fabrics
from experiments.shared.record import read_result
from tests.experiments.known_data import BETAS, FABRICS, known_model, write_known
from tryon_jax.nets.fabric_functions import fit_fabric_functions
from tryon_jax.physics.fabric_numbers import fabric_numbers
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.garments import prepare_simulated
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import ALL_FABRICS, TryOnModel, fine_of, init_model, save_model
from tryon_jax.tryon.stages import fine_stage, smooth_stage


def shared_model() -> TryOnModel:
    """A network of all fabrics that drapes the two of them differently."""
    own = known_model()
    config = replace(own.config, fabrics=(), shared_fabrics=FABRICS, fabric_functions=2)
    model = replace(init_model(jax.random.key(2), config, body=own.body), mean=own.mean, smooth=own.smooth)
    numbers = np.stack([np.asarray(fabric_numbers(load_fabric(name))) for name in FABRICS])
    stage = replace(model.fine[ALL_FABRICS], fabrics=fit_fabric_functions(numbers, np.array([[1.0, 1.0], [1.0, -1.0]])))
    return replace(model, fine={ALL_FABRICS: stage})


@pytest.mark.slow
def test_a_drape_is_right_when_the_fabric_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model, data, run = shared_model(), tmp_path / "data", tmp_path / "run"

    def drapes(name, fabric, _mean, _predicted):
        garment = prepare_simulated(model, data, name)
        stage = fine_of(model, np.asarray(fabric_numbers(load_fabric(fabric))))
        betas = jnp.asarray(BETAS)
        smooth = smooth_stage(model.config, model.smooth, garment, betas)
        return np.asarray(fine_stage(model.config, stage, garment, betas, smooth))[:, : garment.num_vertices]

    write_known(data, known_model(), drapes, ("unseen-tshirt-0",))
    run.mkdir()
    save_model(model_path(run), model, {stage: {} for stage in ("mean", "smooth", f"fine-{ALL_FABRICS}")})
    monkeypatch.setattr(fabrics, "contact_sheet", lambda *_, **__: None)
    monkeypatch.setattr(fabrics, "load_pretrained", lambda _: known_model())
    fabrics.main(fabrics.Config(data, run, out=tmp_path))
    record = read_result(tmp_path, "fabrics")
    assert record is not None
    table = record["results"]["table"]
    for row in table.values():
        assert row["told"] == pytest.approx(0.0, abs=1e-3)
        assert row["told nearest"] > 0.05
        # The only other fabric: its simulation is what the network says when it is told that one.
        assert row["simulated nearest"] == pytest.approx(row["told nearest"], rel=1e-3)
        assert row["curvature predicted"] == pytest.approx(row["curvature simulated"], rel=1e-4)
    assert record["results"]["order"] == pytest.approx(1.0)


def test_the_page_tells_unseen_fabrics_from_trained_ones() -> None:
    row = {"told": 4.0, "told nearest": 6.0, "curvature predicted": 5.0, "curvature simulated": 5.5}
    table = {"a": row, "b": row | {"told": 5.0}, "c": row | {"told": 7.0}}
    page = "\n".join(fabrics.markdown({"table": table, "trained": ["a", "b"], "designs": 6, "order": 0.95}))
    assert "| c | **no** | 7.00 | 6.00 | – | – |" in page
    assert "7.00 mm, 1.56 times the 4.50 mm of trained ones (aim: at most 1.3): not reached" in page
    assert "ρ = 0.95 (aim: at least 0.9): reached" in page
