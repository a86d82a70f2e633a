"""Refining: distances and energies of known drapes, and the table of known entries."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.beyond.refine import TO_REST, compare, draw, markdown, table
from tests.experiments.tiny_garments import AREA, tiny_model
from tryon_jax.garment import load_manifest, remesh
from tryon_jax.tryon import config_space, prepare_mesh


def test_a_drape_beside_itself_and_beside_one_that_is_moved():
    model = tiny_model()
    mesh = remesh(config_space(model.config), load_manifest().design("tank"), AREA, seed=3)
    garment = prepare_mesh(model, mesh)
    rng = np.random.default_rng(0)
    drape = garment.unpad(np.asarray(garment.graph.vertices)) + 0.002 * rng.normal(size=(mesh.num_vertices, 3))
    samples = SimpleNamespace(garment=garment)
    moved = drape + np.array([[0.0, 0.003, 0.0]])
    found = compare(samples, drape.astype(np.float32), {"dataset": drape, "anew": moved})
    assert found["dataset_mm"] == pytest.approx(0.0, abs=1e-4)
    assert found["anew_mm"] == pytest.approx(3.0, rel=1e-3)
    # A shift is smooth: the folds are those of the other drape.
    assert found["dataset_folds"] == pytest.approx(1.0, rel=1e-3)
    assert found["anew_folds"] == pytest.approx(1.0, rel=0.02)


def results():
    entry = {"garment": "tank-0", "betas": [0.0], "residual": 0.01, "anew_seconds": 4.0, "anew_mm": 3.0}
    entry |= {"anew_folds": 0.5, "dataset_folds": 0.5, "taken": 0}
    entries = []
    for steps, error, seconds in ((-1, 3.0, 0.0), (5, 2.5, 0.1), (TO_REST, 2.0, 0.6)):
        of = entry | {"fabric": "knit", "steps": steps, "seconds": seconds}
        entries += [of | {"dataset_mm": error + more} for more in (-0.5, 0.5)]
    return {"designs": 1, "entries": entries}


def test_the_table_has_means_in_the_order_of_the_steps(tmp_path):
    rows = table(results())
    assert [row["steps"] for row in rows] == [-1, 5, TO_REST]
    assert [row["dataset_mm"] for row in rows] == [3.0, 2.5, 2.0]
    text = "\n".join(markdown(results()))
    assert "2 drapes in each fabric" in text
    assert "| knit | none: the learned drape | 3.00 |" in text
    draw(tmp_path / "refine.png", results())
    assert (tmp_path / "refine.png").exists()
