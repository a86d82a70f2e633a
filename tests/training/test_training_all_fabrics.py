"""Training one R_fine of all fabrics: functions from drapes that are known, what is read, a run on tiny data."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from tests.experiments.known_data import FABRICS, known_model, write_known
from tests.experiments.tiny_garments import stretched, tiny_model
from tryon_jax.garment import load_manifest
from tryon_jax.nets.fabric_functions import apply_fabric_functions
from tryon_jax.nets.store import read_record
from tryon_jax.physics.fabric_numbers import fabric_numbers
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.all_fabrics import check_fabrics, fit_all_fabrics, principal_fabrics
from tryon_jax.training.loop import LoopOptions
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_sets import StageSet
from tryon_jax.tryon import ALL_FABRICS, base_and_detail, fine_base, load_model, save_model

THREE = ("gray-interlock", "royal-target", "white-dots-on-blk")
PATTERNS = np.array([[1.0, 1.0], [1.0, -1.0], [1.0, 0.0]])
"""How strongly two displacements are in the drapes of each fabric."""


VALIDATED = f"{load_manifest().validation[0]}-{load_manifest().training_seeds[0]}"
"""A garment that chooses weights."""


def known_sets(missing: bool) -> dict[str, list[StageSet]]:
    """One garment whose drapes are a sum of two orthogonal displacements of 20 and 5 mm."""
    model, samples = tiny_model(), stretched(tiny_model())
    _, detail = base_and_detail(model.config, samples.garment)
    mask = np.asarray(samples.garment.graph.mask)[:, None]
    sets = {}
    for k, fabric in enumerate(THREE):
        offset = (PATTERNS[k][:, None] * [[0.02, 0.0, 0.0], [0.0, 0.005, 0.0]]).sum(axis=0)
        targets = samples.target + (np.asarray(fine_base(model.config, detail)) + offset)[None] * mask[None]
        train = np.ones(len(samples.betas), bool)
        train[k::5] = not missing
        nothing = np.zeros_like(train)
        garment, betas = samples.garment, samples.betas
        sets[fabric] = [StageSet(samples.name, garment, betas, samples.target, targets, train, nothing)]
    return sets


@pytest.mark.parametrize("missing", [False, True])
def test_functions_are_the_principal_components_over_fabrics(missing: bool) -> None:
    found = principal_fabrics(tiny_model(), known_sets(missing), 2)
    numbers = [jnp.asarray(fabric_numbers(load_fabric(fabric))) for fabric in THREE]
    values = np.stack([np.asarray(apply_fabric_functions(found, row)) for row in numbers])
    # The first is nearly the same for all; the second has the pattern of the small displacement, softened by the noise.
    assert np.ptp(values[:, 0]) < 0.2 * abs(values[:, 0]).mean()
    correlation = np.corrcoef(values[:, 1], PATTERNS[:, 1])[0, 1]
    assert abs(correlation) > 0.98


def test_what_cannot_be_trained_is_refused(tmp_path: Path) -> None:
    root = write_known(tmp_path, known_model(), lambda _name, _fabric, _mean, predicted: predicted.fine, ("tshirt-0",))
    with pytest.raises(ValueError, match="'silk'"):
        check_fabrics(root, root, (*FABRICS, "silk"), 2)
    with pytest.raises(ValueError, match=r"\['white-dots-on-blk'\] must be both trained on and simulated"):
        check_fabrics(root, root, FABRICS[:1], 1)
    with pytest.raises(ValueError, match="functions = 3 must be 1 to 2"):
        check_fabrics(root, root, FABRICS, 3)


@pytest.mark.slow
def test_a_run_starts_from_another_and_keeps_its_records(tmp_path: Path, unchecked: None) -> None:
    model = known_model()
    moved = {FABRICS[0]: 0.0, FABRICS[1]: 0.004}

    def drapes(_name, fabric, _mean, predicted):
        return predicted.smooth + np.array([moved[fabric], 0.0, 0.0])

    root = write_known(tmp_path / "data", model, drapes, ("tshirt-0", VALIDATED))
    save_model(tmp_path / "start.safetensors", model, {"mean": {"designs": 1}, "smooth": {"steps": 3}, "fine-x": {}})
    options = StageOptions(LoopOptions(steps=2, evaluate_every=2), garments=1, shapes=2)
    run = tmp_path / "run"
    trained = fit_all_fabrics(root, root, run, tmp_path / "start.safetensors", FABRICS, 2, options)
    record = read_record(model_path(run))["training"]
    assert set(record) == {"mean", "smooth", f"fine-{ALL_FABRICS}"}
    assert record[f"fine-{ALL_FABRICS}"]["fabrics"] == list(FABRICS)
    assert record[f"fine-{ALL_FABRICS}"]["garments"] == 8, "two of both data sets in both fabrics"
    again = load_model(model_path(run))
    assert (
        again.config == trained.config == replace(model.config, fabrics=(), shared_fabrics=FABRICS, fabric_functions=2)
    )
    np.testing.assert_array_equal(again.smooth.net.head.weight, model.smooth.net.head.weight)
    known = trained.fine[ALL_FABRICS].fabrics
    assert known is not None
    np.testing.assert_allclose(known.known[0], fabric_numbers(load_fabric(FABRICS[0])), atol=1e-6)
