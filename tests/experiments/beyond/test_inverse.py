"""Inverse problems: projection, tape and solver on cases with known answers, and a design recovered from its drape."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.beyond.inverse import InverseProblems, draw, markdown
from experiments.beyond.unknowns import Tape, Unknowns, girth_and_hem, solve, template_projection
from tests.experiments.tiny_garments import AREA, FABRIC, tiny_model
from tryon_jax.garment import load_design_space, remesh
from tryon_jax.tryon import drape
from tryon_jax.wear.fit import girth_round

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


def tube(radius, rows=6, columns=120):
    angle = 2 * np.pi * np.arange(columns) / columns
    height = np.linspace(-0.2, 0.3, rows)
    h, a = np.meshgrid(height, angle, indexing="ij")
    points = np.stack([radius * np.sin(a), h, radius * np.cos(a)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    at = [(i + p) * columns + (j + q) % columns for p, q in ((0, 0), (0, 1), (1, 1), (1, 0))]
    corners = [x.ravel() for x in at]
    faces = np.concatenate([np.stack([corners[k] for k in order], 1) for order in ((0, 1, 2), (0, 2, 3))])
    return points, faces


def tape_of(points, faces):
    lowest = points[:, 1] == points[:, 1].min()
    everything = np.ones(len(faces), bool)
    up = np.array([0, 1, 0], np.float32)
    return Tape(faces, everything, lowest, np.array([0, 0.013, 0], np.float32), up, np.float32(-1.0))


def test_girth_and_hem_of_a_tube_and_their_derivatives():
    points, faces = tube(0.2)
    tape = tape_of(points, faces)
    measure = jax.jit(girth_and_hem)
    girth, hem = measure(tape, jnp.asarray(points, jnp.float32))
    assert float(girth) == pytest.approx(
        girth_round(points, faces, np.array([0, 0.013, 0]), np.array([0.0, 1, 0])), 1e-4
    )
    assert float(hem) == pytest.approx(0.8)

    @jax.jit
    @jax.jacfwd
    def slope(scale):
        vertices = jnp.asarray(points, jnp.float32) * jnp.stack([scale[0], scale[1], scale[0]])[None]
        return jnp.stack(girth_and_hem(tape, vertices))

    np.testing.assert_allclose(slope(jnp.ones(2)), [[float(girth), 0.0], [0.0, -0.2]], atol=2e-3)
    beside = replace(tape, torso=points[faces].mean(axis=1)[:, 0] > 0)
    half, _ = measure(beside, jnp.asarray(points, jnp.float32))
    assert float(half) == pytest.approx(0.5 * float(girth), rel=0.03)


def misses(units, args):
    unknowns, wanted = args
    return jnp.concatenate([1e3 * (unknowns.values(units) - wanted), unknowns.beyond(units)])


def test_the_solver_finds_what_is_in_range_and_stays_near_it_otherwise():
    space = load_design_space()
    unknowns = Unknowns.of(space, 2)
    inside = np.concatenate([space.minimum + 0.3 * (space.maximum - space.minimum), [1.0, -0.5]]).astype(np.float32)
    np.testing.assert_allclose(unknowns.values(unknowns.units(inside)), inside, atol=1e-6)
    found = solve(misses, np.zeros(5, np.float32), (unknowns, inside), 30)
    np.testing.assert_allclose(unknowns.values(found.units), inside, atol=1e-4)
    assert found.residual < 0.1
    # Ten metres of garment: the wall holds it near the longest there is.
    outside = inside.copy()
    outside[2] = 10.0
    found = solve(misses, np.zeros(5, np.float32), (unknowns, outside), 30)
    assert unknowns.values(found.units)[0] == pytest.approx(inside[0], abs=1e-3)
    assert found.residual > 100


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
        "steps": 9,
        "seconds": 2.0,
    }
    results = {"fabric": "f", "recovered": recovered, "fits": [fit], "names": ["sleeve", "chest", "length"]}
    text = "\n".join(markdown(results))
    assert "| the model (2 drapes) | 2.0 (worst 3.0) | 4.0 (worst 6.0) | 6.0 (worst 9.0) |" in text
    assert "| 1, 0: 10.0 · 80.0 | 10.0 · 100.0 · 60.0 | 10.1 · 80.1 | – | 9 | 2.0 |" in text
    # Records of before say so in other words.
    old = {**results, "wishes": [{**fit, "wish": fit["asked"]}]}
    del old["fits"]
    assert markdown(old) == markdown(results)
    draw(tmp_path / "inverse.png", results)
    assert (tmp_path / "inverse.png").exists()
