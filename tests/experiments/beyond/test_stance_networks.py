"""Errors of lowered arms on descents whose change is known."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.beyond.stance_networks import (
    HELD_OUT,
    STANCES,
    StanceNeighbours,
    load_cases,
    markdown,
    measure,
    spread,
)
from tests.experiments.known_data import BETAS, FABRICS, GARMENTS, known_model, write_known
from tests.tryon.test_learned_stance import with_stance
from tryon_jax.body.pose import skinning_motion
from tryon_jax.body.stance import arms_pose
from tryon_jax.garment import load_manifest
from tryon_jax.graph.skinning import garment_skinning
from tryon_jax.training.dataset import save_arrays
from tryon_jax.training.descents import DescentTask
from tryon_jax.training.drapes import load_mesh
from tryon_jax.training.garments import prepare_simulated
from tryon_jax.tryon import TryOnModel

NAMES = ("tshirt-0", "unseen-tshirt-0")


@pytest.fixture(scope="module")
def model() -> TryOnModel:
    """R_stance changes nothing."""
    model = with_stance(known_model())
    assert model.stance is not None
    return replace(model, stance=replace(model.stance, stage=replace(model.stance.stage, scale=jnp.asarray(0.0))))


@pytest.fixture(scope="module")
def root(model: TryOnModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cloth that is skinned and sinks by a centimetre, in T-pose, on the way to 45 degrees; in one of two fabrics."""
    folder = tmp_path_factory.mktemp("data")
    write_known(folder, model, lambda _name, _fabric, mean, _: np.repeat(mean[None], len(BETAS), axis=0), NAMES)
    for name in NAMES:
        garment = prepare_simulated(model, folder, name)
        start, betas = garment.mean_vertices, BETAS[2]
        weights = garment_skinning(start, garment.faces, model.body).astype(np.float32)
        drapes = []
        for degrees in STANCES:
            linear, shift = skinning_motion(
                model.body, betas, arms_pose(model.body, degrees).astype(np.float32), weights
            )
            sunk = start - np.float32([0.0, 0.01 * degrees / 45.0, 0.0])
            drapes.append(np.einsum("vab,vb->va", np.asarray(linear), sunk) + np.asarray(shift))
        arrays = {"betas": betas.astype(float), "test": name.startswith("unseen"), "start": start}
        arrays |= {"degrees": np.float32(STANCES), "vertices": np.float32(drapes)}
        save_arrays(
            DescentTask(name, FABRICS[0], 0, 1).path(folder), arrays | {"residual": np.float32([0.01, 0.01, 0.01, 0.5])}
        )
    return folder


def test_two_topologies_of_a_design_are_compared_through_the_pattern(model: TryOnModel, tmp_path: Path) -> None:
    write_known(tmp_path, model, lambda _n, _f, mean, _: np.repeat(mean[None], len(BETAS), axis=0), GARMENTS[:2])
    for name, height in zip(GARMENTS[:2], (0.0, 0.003), strict=True):
        start = prepare_simulated(model, tmp_path, name).mean_vertices
        # In the plane of the pattern a drape that is linear in it is read without error on any mesh.
        uv = load_mesh(tmp_path, name)
        flat = np.zeros_like(start)
        flat[uv["faces"]] = np.pad(uv["uv"], ((0, 0), (0, 1)))[uv["faces_uv"]]
        vertices = (flat * [1.0, 1.0, 0.0] + [0.0, 0.0, height])[None].astype(np.float32)
        arrays = {"betas": np.zeros(2), "test": False, "start": start, "degrees": np.float32([45.0])}
        path = DescentTask(name, FABRICS[0]).path(tmp_path)
        save_arrays(path, arrays | {"vertices": vertices, "residual": np.float32([0.01])})
    cases = load_cases(model, tmp_path, load_manifest())
    found = spread(tmp_path, cases)
    assert found[FABRICS[0]]["45"] == pytest.approx(3.0, abs=1.5)


def test_errors_are_the_changes_that_a_way_leaves_out(model: TryOnModel, root: Path) -> None:
    manifest = load_manifest()
    (case,) = load_cases(model, root, manifest)
    assert case.name == "unseen-tshirt-0", "nothing that was trained on is measured"
    rows = measure(model, case, StanceNeighbours(model, root, manifest))
    assert [row["degrees"] for row in rows] == [15.0, HELD_OUT, 30.0], "at 45 degrees it is not at rest"
    for row in rows:
        sunk = 10.0 * row["degrees"] / 45.0
        # Linear skinning blends rotations, which shortens a vector a little where joints meet.
        assert row["errors"]["skinned"] == pytest.approx(sunk, rel=0.05)
        assert row["errors"]["R_stance"] == pytest.approx(row["errors"]["skinned"], rel=1e-3)
        assert row["errors"]["kNN"] < 0.02
        assert row["t_pose"] > 0.01, "an untrained network"
    lines = markdown({"rows": rows, "trained": list(FABRICS), "cases": 1, "spread": {"knit": {"45": 2.0, "15": 1.0}}})
    assert any(line.startswith("| unseen designs on test bodies | 15° | 3.") for line in lines)
    assert "in knit are apart by, mm: 1.00 at 15°, 2.00 at 45°." in lines[-1]
    assert not any("| 45° |" in line for line in lines)
