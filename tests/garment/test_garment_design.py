"""Design spaces, designs, sampling, presets."""

import numpy as np
import pytest

from tryon_jax.garment import load_design_space, load_manifest

SPACE = load_design_space()


def test_three_active_parameters() -> None:
    assert SPACE.names == ("sleeve_length", "chest", "length")
    assert (SPACE.minimum < SPACE.mean).all()
    assert (SPACE.mean < SPACE.maximum).all()


def test_design_by_name_fills_in_means() -> None:
    design = SPACE.design(sleeve_length=0.15)
    np.testing.assert_array_equal(design.values, [0.15, SPACE.mean[1], SPACE.mean[2]])
    assert design["sleeve_length"] == 0.15
    assert SPACE.from_values(design.values).as_dict() == design.as_dict()
    assert "sleeve_length 0.150 m" in str(design)


def test_a_fourth_parameter_needs_no_code() -> None:
    wide = load_design_space(parameters=("sleeve_length", "chest", "length", "hem_flare"))
    assert wide.names[-1] == "hem_flare"
    hem = {flare: wide.draw(wide.design(length=1.1, hem_flare=flare))["hem"] for flare in (0.0, 0.16)}
    added = np.ptp(hem[0.16][:, 0]) - np.ptp(hem[0.0][:, 0])
    # The parameter is the addition to each panel's half width at a length of 1.2 m, from 0.6 m linearly.
    assert added == pytest.approx(2 * 0.16 * (1.1 - 0.6) / 0.6, abs=1e-9)
    fixed = wide.design(length=1.1).as_dict()
    assert fixed["hem_flare"] == wide.layout.parameter("hem_flare").mean
    np.testing.assert_array_equal(
        wide.draw(wide.design(length=1.1))["hem"], SPACE.draw(SPACE.design(length=1.1))["hem"]
    )


def test_presets() -> None:
    assert {"tank", "tshirt", "sweater", "dress", "maxi-dress"} <= set(SPACE.presets)
    for name in SPACE.presets:
        assert SPACE.preset(name).label == name
    assert SPACE.preset("sweater")["sleeve_length"] > SPACE.preset("tshirt")["sleeve_length"]
    assert SPACE.preset("maxi-dress")["length"] > SPACE.preset("dress")["length"] > SPACE.preset("tshirt")["length"]
    with pytest.raises(ValueError, match=r"unknown design 'dres'.*did you mean 'dress'"):
        SPACE.preset("dres")


def test_grid() -> None:
    table = np.stack([d.values for d in SPACE.grid(3)])
    assert table.shape == (27, 3)
    np.testing.assert_array_equal(table.min(axis=0), SPACE.minimum)
    np.testing.assert_array_equal(table.max(axis=0), SPACE.maximum)
    chest = np.stack([d.values for d in SPACE.grid({"chest": 4})])
    assert chest.shape == (4, 3)
    np.testing.assert_array_equal(chest[:, 0], SPACE.mean[0])
    with pytest.raises(ValueError, match="unknown parameter 'girth'"):
        SPACE.grid({"girth": 2})
    with pytest.raises(ValueError, match="grid steps of chest = 0"):
        SPACE.grid({"chest": 0})


def test_samples_are_seeded_and_spread() -> None:
    table = np.stack([d.values for d in SPACE.sample(64, seed=3)])
    np.testing.assert_array_equal(table, np.stack([d.values for d in SPACE.sample(64, seed=3)]))
    assert not np.allclose(table, np.stack([d.values for d in SPACE.sample(64, seed=4)]))
    # A Sobol sequence of 64 has 8 points in each eighth of every axis.
    for k in range(3):
        unit = (table[:, k] - SPACE.minimum[k]) / (SPACE.maximum[k] - SPACE.minimum[k])
        np.testing.assert_array_equal(np.histogram(unit, 8, (0, 1))[0], 8)
    assert len(SPACE.sample(5, seed=0)) == 5


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"chest": 2.0}, r"chest = 2 m is outside its range 0\.88 to 1\.18 m"),
        ({"chest": float("nan")}, "chest must be finite"),
        ({"length": float("inf")}, "length must be finite"),
        ({"chst": 1.0}, "unknown parameter 'chst'.*did you mean 'chest'"),
        ({"hem_flare": 0.1}, "unknown parameter 'hem_flare'"),
    ],
)
def test_bad_designs(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SPACE.design(**values)


def test_bad_vectors() -> None:
    with pytest.raises(ValueError, match=r"a design needs 3 numbers \(sleeve_length, chest, length\)"):
        SPACE.from_values([0.1, 1.0])
    with pytest.raises(ValueError, match="must be finite"):
        SPACE.from_values([0.1, np.nan, 1.0])


def test_bad_spaces() -> None:
    with pytest.raises(ValueError, match="unknown parameter 'girth'"):
        load_design_space(parameters=("girth",))
    with pytest.raises(ValueError, match="must be different and at least one"):
        load_design_space(parameters=("chest", "chest"))
    with pytest.raises(ValueError, match="at least one"):
        load_design_space(parameters=())
    with pytest.raises(ValueError, match="number of designs = 0"):
        SPACE.sample(0, seed=0)


def test_manifest() -> None:
    """19 training designs, 6 unseen, 2 training and 7 test topologies (section "Evaluation" of the paper)."""
    manifest = load_manifest()
    assert (len(manifest.training), len(manifest.unseen)) == (19, 6)
    assert (len(manifest.training_seeds), len(manifest.test_seeds)) == (2, 7)
    assert len(manifest.additional) == 1000
    assert set(manifest.validation) < {d.label for d in manifest.additional}
    assert len({d.label for d in manifest.designs}) == 1025
    # Designs that choose the weights or test are fitted nowhere.
    held = {tuple(d.values) for d in (*manifest.unseen, *map(manifest.design, manifest.validation))}
    fitted = [d for d in (*manifest.training, *manifest.additional) if d.label not in manifest.validation]
    assert not held & {tuple(d.values) for d in fitted}
    assert len(manifest.training_garments(additional=False)) == 38
    assert len(manifest.training_garments()) == 1038
    assert manifest.split("additional-0", manifest.training_seeds[0]) == "training"
    # Only the first topology of these is simulated for training.
    assert manifest.split("additional-0", manifest.training_seeds[1]) == "test"
    assert not set(manifest.training_seeds) & set(manifest.test_seeds)
    assert manifest.split("tshirt", manifest.training_seeds[1]) == "training"
    assert manifest.split("tshirt", manifest.test_seeds[0]) == "test"
    assert manifest.split("unseen-tank", manifest.training_seeds[0]) == "test"
    assert manifest.design("dress").label == "dress"
    with pytest.raises(ValueError, match="seed 99 is in no split"):
        manifest.split("tshirt", 99)
    with pytest.raises(ValueError, match="unknown design"):
        manifest.split("coat", 0)
