"""JAX in double precision, as users set it: everything runs, in the precision of what it holds."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flat_model import flat_model

import tryon_jax as tj
from tryon_jax.cli import main
from tryon_jax.tryon.model import model_parameters

_SCRIPT = """
import sys
import jax, numpy as np
import tryon_jax as tj
from tryon_jax.cli import main

assert jax.config.jax_enable_x64
model = tj.load_pretrained()
assert {leaf.dtype.name for leaf in jax.tree.leaves(tj.tryon.model.model_parameters(model))} == {"float32", "int32"}
garment = tj.prepare(model, "tshirt", target_area=1.2e-3)
drape = tj.drape(model, garment, np.array([0.5, -0.5], np.float32))
assert drape.dtype == "float32", drape.dtype
np.save(sys.argv[1], garment.unpad(drape))
options = ["--design", "tshirt", "--stature", "1.7", "--triangle-area", "12", "--report", sys.argv[2]]
assert main(["drape", *options]) == 0
assert main(["body", "--stature", "1.7"]) == 0
"""


@pytest.mark.slow
def test_everything_runs_in_double_precision_and_gives_the_same(tmp_path: Path) -> None:
    drape, report = tmp_path / "drape.npy", tmp_path / "report.json"
    environment = os.environ | {"JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-W", "error", "-c", _SCRIPT, str(drape), str(report)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert report.exists()
    model = tj.load_pretrained()
    garment = tj.prepare(model, "tshirt", target_area=1.2e-3)
    single = garment.unpad(tj.drape(model, garment, np.array([0.5, -0.5], np.float32)))
    np.testing.assert_allclose(np.load(drape), single, atol=2e-5)


@pytest.mark.usefixtures("x64")
def test_a_stored_model_keeps_its_precision(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    with jax.enable_x64(False):
        tj.save_model(path, flat_model())
    leaves = jax.tree.leaves(model_parameters(tj.load_model(path)))
    assert {np.asarray(leaf).dtype.name for leaf in leaves} == {"float32"}


@pytest.mark.usefixtures("x64")
def test_measurements_are_met_in_double_precision() -> None:
    body = tj.load_body("female")
    fit = tj.betas_from_measurements(body, {"stature": 1.7})
    assert fit.betas.dtype == jnp.float32
    assert abs(fit.residuals["stature"]) < 1e-3
    assert main(["body", "--stature", "1.7"]) == 0
