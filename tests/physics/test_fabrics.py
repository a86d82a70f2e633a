"""The fabrics file, its tables, and what happens to files that are wrong."""

import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

from tryon_jax.physics import fabrics
from tryon_jax.physics.fabrics import GRID, GRID_LOW, Fabric, fabric_names, load_fabric, stretch_table

SOURCE = tomllib.loads((Path(fabrics.__file__).parents[1] / "data" / "fabrics.toml").read_text())


def test_ten_measured_fabrics_load() -> None:
    assert len(fabric_names()) == 10
    assert {"gray-interlock", "white-dots-on-blk"} <= set(fabric_names())
    for name in fabric_names():
        fabric = load_fabric(name)
        assert fabric.name == name
        np.testing.assert_allclose(fabric.bending, SOURCE[name]["bending"], rtol=1e-6)
        assert float(fabric.density) == pytest.approx(SOURCE[name]["density"], rel=1e-6)
        assert np.asarray(fabric.stretch_table).min() >= 0
        assert 0.05 < float(fabric.density) < 0.6


def test_measured_facts() -> None:
    # Wang, O'Brien, Ramamoorthi 2011, as their data are distributed with Narain et al. 2012.
    knit, woven = SOURCE["gray-interlock"], SOURCE["white-dots-on-blk"]
    assert (knit["density"], woven["density"]) == (0.187, 0.128)
    assert knit["stretching"][0] == [16.593832, -14.69599, 34.477123, 36.860302]
    stiffer = np.array(woven["stretching"])[0, [0, 2]] / np.array(knit["stretching"])[0, [0, 2]]
    assert (stiffer > 20).all()


def test_rows_of_the_table_are_read_at_their_direction() -> None:
    rows = np.arange(24, dtype=float).reshape(6, 4) + 1
    table = stretch_table(rows)
    compressed, stretched = 0, GRID - 1
    # Compressed both ways: zero strain's row. Stretched beyond 1/6 along u, along v, and at 45 degrees.
    np.testing.assert_allclose(table[compressed, compressed, 0], 2 * rows[0])
    np.testing.assert_allclose(table[stretched, compressed, 0], 2 * rows[1])
    np.testing.assert_allclose(table[compressed, stretched, 0], 2 * rows[5])
    np.testing.assert_allclose(table[10, 10, GRID - 1], 2 * rows[3])
    # Half way between: where tan 2a = 2 G01 / (G00 - G11) gives 33.75 degrees, the mean of two rows.
    g01 = np.arange(GRID) / GRID
    difference = (np.arange(GRID) - compressed) / GRID
    a, b = np.unravel_index(
        np.abs(np.arctan2(2 * g01[None], difference[:, None]) - np.deg2rad(67.5)).argmin(), (GRID, GRID)
    )
    angle = 0.5 * np.arctan2(2 * g01[b], difference[a])
    share = angle / (np.pi / 8) - 1
    normal = GRID_LOW + np.array([a, compressed]) / GRID
    s = np.sqrt(1 + normal.sum() + np.hypot(normal[0] - normal[1], 2 * g01[b]))
    weight = min(1.0, 6 * (s - 1))
    expected = (1 - weight) * rows[0] + weight * ((1 - share) * rows[2] + share * rows[3])
    np.testing.assert_allclose(table[a, compressed, b], 2 * expected, rtol=1e-12)


def test_negative_measurements_are_clipped_and_values_doubled() -> None:
    rows = np.full((6, 4), 3.0)
    rows[0, 1] = -5.0
    table = stretch_table(rows)
    assert table[0, 0, 0].tolist() == [6.0, 0.0, 6.0, 6.0]
    assert table.min() == 0.0


def test_a_fabric_is_a_pytree_and_its_name_is_not_a_leaf() -> None:
    leaves = jax.tree.leaves(load_fabric("gray-interlock"))
    assert len(leaves) == 5


def as_toml(**changes: object) -> str:
    entries: dict[str, object] = {
        "density": 0.2,
        "stretching": [[10.0, 1.0, 10.0, 5.0]] * 6,
        "bending": [[1e-5] * 5] * 3,
        **changes,
    }
    lines = [f"{key} = {value}" for key, value in entries.items() if value is not None]
    return "[mine]\n" + "\n".join(lines) + "\n"


def read(tmp_path: Path, text: str) -> Fabric:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return load_fabric(path)


def test_compiled_code_does_not_tell_fabrics_apart_by_name() -> None:
    first, second = load_fabric("gray-interlock"), load_fabric("white-dots-on-blk")
    assert jax.tree.structure(first) != jax.tree.structure(second)
    assert jax.tree.structure(first.unnamed) == jax.tree.structure(second.unnamed)
    np.testing.assert_array_equal(first.unnamed.stretch_table, first.stretch_table)


def test_a_fabric_of_ones_own(tmp_path: Path) -> None:
    fabric = read(tmp_path, as_toml(friction=0.5, thickness=0.003))
    assert (fabric.name, float(fabric.friction)) == ("mine", 0.5)
    assert float(fabric.thickness) == pytest.approx(0.003)
    np.testing.assert_allclose(fabric.stretch_table[5, 5, 5], [20, 2, 20, 10])
    assert float(read(tmp_path, as_toml()).friction) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"density": None}, "no entry 'density'"),
        ({"stretching": None}, "no entry 'stretching'"),
        ({"bending": None}, "no entry 'bending'"),
        ({"density": -0.2}, r"density of fabric 'mine' = -0.2 kg/m² is outside"),
        ({"density": "nan"}, "density of fabric 'mine' must be finite"),
        ({"density": "'heavy'"}, "density"),
        ({"friction": 5.0}, "friction"),
        ({"thickness": 0.0}, "thickness"),
        ({"stretching": [[10.0, 1.0, 10.0, 5.0]] * 5}, r"stretching of fabric 'mine' must be 6 x 4, got \(5, 4\)"),
        ({"stretching": [[10.0, 1.0, 10.0]] * 5 + [[1.0]]}, "stretching of fabric 'mine' must be a 6 x 4 table"),
        ({"stretching": [[-1.0, 1.0, 10.0, 5.0]] * 6}, "zero strain must not be negative"),
        ({"stretching": "[['a', 'b']]"}, "stretching of fabric 'mine'"),
        ({"bending": [[1e-5] * 4] * 3}, "bending of fabric 'mine' must be 3 x 5"),
        ({"bending": [[1e-5] * 4 + [-1e-6]] * 3}, "bending must not be negative"),
        ({"bending": "[[1e-5, 1e-5, 1e-5, 1e-5, inf], [1, 1, 1, 1, 1], [1, 1, 1, 1, 1]]"}, "finite"),
        ({"densitty": 0.2}, "unknown entry of fabric 'mine' 'densitty' .did you mean 'density'"),
    ],
)
def test_bad_files(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        read(tmp_path, as_toml(**changes))


def test_files_that_are_no_fabric(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not valid TOML"):
        read(tmp_path, "[mine\n")
    with pytest.raises(ValueError, match=r"exactly one .* found 2"):
        read(tmp_path, "[a]\n[b]\n")
    with pytest.raises(ValueError, match="exactly one"):
        read(tmp_path, "density = 3\n")
    with pytest.raises(FileNotFoundError, match="fabric file"):
        load_fabric(tmp_path / "absent.toml")
    with pytest.raises(ValueError, match=r"unknown fabric 'gray-interlok' .did you mean 'gray-interlock'"):
        load_fabric("gray-interlok")
