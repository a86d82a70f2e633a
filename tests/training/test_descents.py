"""Descents of a dataset: which are planned, what is stored, what is read."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tryon_jax.training.descents as descents
from tests.experiments.known_data import BETAS, FABRICS, TEST, known_model, write_known
from tryon_jax.garment import load_manifest
from tryon_jax.physics.dressing import Diverged
from tryon_jax.training.dataset import load_arrays, ray_path, save_arrays
from tryon_jax.training.descents import DescentTask, load_descents, plan_descents, run_descent

NAMES = ("tshirt-0", "unseen-tshirt-0")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drapes that rise by a centimetre with each body shape, with no slip."""
    folder = tmp_path_factory.mktemp("data")

    def drapes(_name, _fabric, mean, _predicted):
        return mean[None] + 0.01 * np.arange(len(BETAS))[:, None, None]

    write_known(folder, known_model(), drapes, NAMES)
    for path in (*(folder / "rays").glob("*.npz"), *(folder / "mean").glob("*.npz")):
        arrays = load_arrays(path)
        save_arrays(path, arrays | {"slip": np.zeros_like(arrays["vertices"])})
    return folder


def test_trained_garments_descend_on_training_shapes_and_others_on_test_shapes(root: Path) -> None:
    tasks = plan_descents(root, load_manifest(), NAMES, FABRICS[:1], 2)
    assert [(t.garment, t.body_name) for t in tasks[:2]] == [(name, "mean") for name in NAMES], "evenly from the start"
    for task in tasks[2:]:
        ray = load_arrays(ray_path(root, task.garment, FABRICS[0], task.ray))
        assert bool(ray["test"][task.shape]) == task.garment.startswith("unseen")
    assert tasks[2].shape == np.flatnonzero(~TEST[1:])[-1], "the outermost shape"
    assert len(tasks) == 4
    assert len(plan_descents(root, load_manifest(), NAMES, FABRICS, 1)) == 4
    assert not plan_descents(root, load_manifest(), NAMES, ("royal-target",), 2), "not simulated"


@pytest.mark.parametrize("diverges", [False, True])
def test_what_is_stored_is_read_again(root: Path, monkeypatch: pytest.MonkeyPatch, diverges: bool) -> None:
    fabric = FABRICS[int(diverges)]
    task = DescentTask(NAMES[0], fabric, 0, 2)
    start = load_arrays(ray_path(root, NAMES[0], fabric, 0))["vertices"][2]

    def relaxed(vertices, slip, betas, *_, max_steps):
        assert max_steps == 0, "a drape at rest stays where it is"
        np.testing.assert_array_equal(vertices, start)
        np.testing.assert_allclose(betas, BETAS[3])
        return "laid"

    def lowered(laid, weights, degrees, *_):
        assert laid == "laid"
        assert degrees == 45.0
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
        for angle, residual in ((22.5, 0.01), (45.0, 0.03)):
            report = SimpleNamespace(residual=residual)
            yield SimpleNamespace(degrees=angle, drape=SimpleNamespace(vertices=start - 0.001 * angle, report=report))
            if diverges:
                raise Diverged("forces became infinite")
        pytest.fail("nothing starts from cloth that found no rest")

    monkeypatch.setattr(descents, "relax", relaxed)
    monkeypatch.setattr(descents, "lower_arms", lowered)
    assert run_descent(str(root), task).startswith(f"tshirt-0 {fabric} 00-2: {22.5 if diverges else 45:g} degrees")
    assert run_descent(str(root), task) == "", "done before"
    (found,) = load_descents(root, NAMES[0], fabric)
    assert not found.test
    np.testing.assert_allclose(found.betas, BETAS[3])
    np.testing.assert_array_equal(found.degrees, [22.5] if diverges else [22.5, 45.0])
    np.testing.assert_array_equal(found.at_rest, [True] if diverges else [True, False])
    np.testing.assert_allclose(found.vertices[0], start - 0.0225, atol=1e-7)
