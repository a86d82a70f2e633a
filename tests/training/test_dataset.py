"""The dataset on disk: whole files or none, one configuration, rules that decide what is used."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tryon_jax.training import dataset
from tryon_jax.training.dataset import (
    MAX_DEPTH,
    MAX_RESIDUAL,
    MAX_SELF_INTERSECTIONS,
    MAX_TENSION,
    STATISTICS,
    DatasetConfig,
    default_root,
    is_good,
    load_arrays,
    mean_path,
    mesh_path,
    open_dataset,
    ray_path,
    read_config,
    save_arrays,
    template_path,
)


def test_paths_are_where_the_docstring_says(tmp_path: Path) -> None:
    assert mesh_path(tmp_path, "tshirt-0") == tmp_path / "meshes/tshirt-0.npz"
    assert mean_path(tmp_path, "tshirt-0", "denim") == tmp_path / "mean/tshirt-0_denim.npz"
    assert ray_path(tmp_path, "tshirt-0", "denim", 3) == tmp_path / "rays/tshirt-0_denim_03.npz"
    assert template_path(tmp_path, "tshirt") == tmp_path / "templates/tshirt.npz"


def test_folder_by_default(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TRYON_JAX_DATA", str(tmp_path / "here"))
    assert default_root() == tmp_path / "here"
    monkeypatch.delenv("TRYON_JAX_DATA")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_root() == tmp_path / "tryon_jax" / "dataset"


def test_arrays_come_back(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "a.npz"
    arrays = {"vertices": np.arange(12, dtype=np.float32).reshape(4, 3), "steps": np.float32(3), "versions": "{}"}
    save_arrays(path, arrays)
    found = load_arrays(path)
    assert set(found) == set(arrays)
    np.testing.assert_array_equal(found["vertices"], arrays["vertices"])
    assert found["vertices"].dtype == np.float32
    assert str(found["versions"]) == "{}"
    assert [p.name for p in path.parent.iterdir()] == ["a.npz"]


def test_a_failed_save_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npz"
    save_arrays(path, {"x": np.arange(3)})

    def full_disk(file: Path, **arrays: np.ndarray) -> None:
        Path(file).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full_disk)
    with pytest.raises(OSError, match="No space left"):
        save_arrays(path, {"x": np.arange(4)})
    monkeypatch.undo()
    np.testing.assert_array_equal(load_arrays(path)["x"], np.arange(3))
    assert len(list(tmp_path.iterdir())) == 1


def test_missing_is_not_damaged(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_arrays(tmp_path / "absent.npz")


@given(data=st.data())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_file_is_an_error_that_names_it(tmp_path: Path, data: st.DataObject) -> None:
    """Cut anywhere, or with a byte changed: either a clear error or, where the byte says nothing, the same arrays."""
    path = tmp_path / "a.npz"
    save_arrays(path, {"vertices": np.arange(30, dtype=np.float32), "test": np.arange(3) > 1})
    whole = path.read_bytes()
    at = data.draw(st.integers(0, len(whole) - 1))
    if data.draw(st.booleans()):
        path.write_bytes(whole[:at])
    else:
        flipped = bytearray(whole)
        flipped[at] ^= data.draw(st.integers(1, 255))
        path.write_bytes(bytes(flipped))
    expected = (np.arange(30.0).tolist(), (np.arange(3) > 1).tolist())
    if len(path.read_bytes()) == len(whole):
        try:
            assert all(value.tolist() in expected for value in load_arrays(path).values())
        except ValueError:
            pass
        else:
            return
    with pytest.raises(ValueError, match=r"a\.npz' is damaged .* delete it and simulate again"):
        load_arrays(path)


def test_pickles_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, x=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="damaged"):
        load_arrays(path)


def test_a_folder_belongs_to_one_configuration(tmp_path: Path) -> None:
    config = DatasetConfig(num_betas=1, target_area=6e-4)
    assert open_dataset(tmp_path / "set", config) == tmp_path / "set"
    written = (tmp_path / "set" / "config.json").read_bytes()
    open_dataset(tmp_path / "set", config)
    assert (tmp_path / "set" / "config.json").read_bytes() == written
    assert read_config(tmp_path / "set") == config
    with pytest.raises(
        ValueError, match=r"num_betas = 1 \(asked for 2\), target_area = 0.0006 .*another folder"
    ) as error:
        open_dataset(tmp_path / "set", DatasetConfig())
    assert "body" not in str(error.value).replace(str(tmp_path), "")
    assert (tmp_path / "set" / "config.json").read_bytes() == written


def test_folders_that_are_no_dataset(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no dataset at .*experiments simulate"):
        read_config(tmp_path)
    for text in ("{", "[]", json.dumps({"body": "female"}), json.dumps({"colour": 1})):
        (tmp_path / "config.json").write_text(text)
        with pytest.raises(ValueError, match=r"config\.json"):
            read_config(tmp_path)


def good(**changes: float) -> dict[str, np.ndarray]:
    row = dict.fromkeys(STATISTICS, 0.0) | changes
    return {key: np.array([value]) for key, value in row.items()}


@pytest.mark.parametrize(
    ("key", "limit"),
    [
        ("residual", MAX_RESIDUAL),
        ("depth", MAX_DEPTH),
        ("self_intersections", MAX_SELF_INTERSECTIONS),
        ("tension", MAX_TENSION),
    ],
)
def test_each_rule_decides_at_its_limit(key: str, limit: float) -> None:
    assert is_good(good()).all()
    assert is_good(good(**{key: limit})).all()
    assert not is_good(good(**{key: 1.001 * limit})).any()
    assert not is_good(good(**{key: np.nan})).any()


KILLED = """
import os, signal, sys
import numpy as np
from pathlib import Path
from tryon_jax.training import dataset

real = np.savez
def savez(file, **arrays):
    real(file, **arrays)
    if arrays["x"][0] == 2:
        with open(file, "r+b") as handle:
            handle.truncate(100)
        os.kill(os.getpid(), signal.SIGKILL)
np.savez = savez
root = Path(sys.argv[1])
for k in range(4):
    path = dataset.ray_path(root, "tshirt-0", "denim", k)
    if not path.exists():
        print(k, flush=True)
        dataset.save_arrays(path, {"x": np.full(1000, k)})
"""


def test_kill_9_in_the_middle_of_a_save_loses_nothing(tmp_path: Path) -> None:
    def work(script: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", script, str(tmp_path)]
        return subprocess.run(
            command, capture_output=True, text=True, cwd=Path(dataset.__file__).parents[2], check=False
        )

    killed = work(KILLED)
    assert killed.returncode == -9
    assert killed.stdout.split() == ["0", "1", "2"]
    found = sorted(path.name for path in (tmp_path / "rays").glob("t*.npz"))
    assert found == ["tshirt-0_denim_00.npz", "tshirt-0_denim_01.npz"]
    times = [os.stat(tmp_path / "rays" / name).st_mtime_ns for name in found]
    again = work(KILLED.replace('arrays["x"][0] == 2', "False"))
    assert again.returncode == 0, again.stderr
    assert again.stdout.split() == ["2", "3"]
    for k in range(4):
        assert (load_arrays(ray_path(tmp_path, "tshirt-0", "denim", k))["x"] == k).all()
    assert [os.stat(tmp_path / "rays" / name).st_mtime_ns for name in found] == times
