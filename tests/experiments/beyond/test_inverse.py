"""Inverse problems: projection, tape and solver on cases with known answers, and a design recovered from its drape."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.beyond.inverse import InverseProblems, draw, markdown
from experiments.beyond.template import template_projection
from tests.experiments.tiny_garments import AREA, FABRIC, tiny_model
from tryon_jax.garment import load_design_space, remesh
from tryon_jax.tryon import drape

pytestmark = pytest.mark.usefixtures("unchecked")


def test_the_projection_is_the_templates_least_squares_fit():
    space = load_design_space()
    mesh = remesh(space, space.mean_design, AREA, seed=0)
    vertices = np.random.default_rng(0).normal(size=(mesh.num_vertices, 3))
    size = int(mesh.template_vertices.max()) + 1
    projection, seen = template_projection(mesh.template_vertices, mesh.template_weights, size)
    assert 0 <= seen.min() < seen.max() == 1
    whole = np.zeros((mesh.num_vertices, size))
    for k in range(3):
        whole[np.arange(mesh.num_vertices), mesh.template_vertices[:, k]] += mesh.template_weights[:, k]
    near = (whole.T @ vertices) / np.maximum(whole.sum(axis=0), 1e-9)[:, None]
    rows = np.concatenate([whole, 0.02**0.5 * np.eye(size)]), np.concatenate([vertices, 0.02**0.5 * near])
    np.testing.assert_allclose(projection @ vertices, np.linalg.lstsq(*rows)[0], atol=1e-4)


@pytest.mark.slow
def test_a_design_is_recovered_from_its_drape_on_another_topology():
    model = tiny_model()
    # A mesh as coarse as the template would leave much of it unseen.
    model = replace(model, config=replace(model.config, target_area=8e-4))
    problems = InverseProblems(model, FABRIC, bucket=768)
    space = problems.space
    design = space.minimum + np.array([0.3, 0.6, 0.4]) * (space.maximum - space.minimum)
    garment, mesh = problems.garment(design, seed=5)
    vertices = garment.unpad(drape(model, garment, np.zeros(2, np.float32), fabric=FABRIC))
    size = model.config.template_vertices
    projection, seen = template_projection(mesh.template_vertices, mesh.template_weights, size)
    found, _, info = problems.recover(projection @ vertices, seen, rounds=2, steps=12)
    start = np.abs(space.mean - design)
    assert (np.abs(found - design) < 0.15 * start + 0.004).all(), (found, design)
    assert info.residual < 1.0


def test_tables(tmp_path):
    recovered = [
        {
            "maker": maker,
            "name": "a",
            "design": [0.1, 1.0, 0.6],
            "betas": [0.0, 1.0],
            "found_design": [0.1, 1.0, 0.6],
            "found_betas": [0.0, 1.0],
            "design_error_mm": [e, 2 * e, 3 * e],
            "betas_error": [0.01, 0.02],
            "residual_mm": [2.0, 1.0],
            "steps": 10,
            "seconds": 3.0,
        }
        for maker, e in (("the model", 1.0), ("the model", 3.0), ("the simulator", 5.0))
    ]
    fit = {
        "betas": [1.0, 0.0],
        "asked": [0.1, 0.8],
        "design": [0.1, 1.0, 0.6],
        "got": {"predicted": [0.101, 0.801]},
        "rounds": 3,
        "seconds": 2.0,
    }
    results = {"fabric": "f", "recovered": recovered, "fits": [fit], "names": ["sleeve", "chest", "length"]}
    text = "\n".join(markdown(results))
    assert "| the model (2 drapes) | 2.0 (worst 3.0) | 4.0 (worst 6.0) | 6.0 (worst 9.0) |" in text
    assert "| 1, 0: 10.0 · 80.0 | 10.0 · 100.0 · 60.0 | 10.1 · 80.1 | – | 3 | 2.0 |" in text
    draw(tmp_path / "inverse.png", results)
    assert (tmp_path / "inverse.png").exists()
