import os

import pytest

from tryon_jax.files.atomic import atomic_path, write_text


def test_a_failed_write_leaves_the_old_file_and_no_debris(tmp_path):
    target = tmp_path / "result.txt"
    write_text(target, "old")

    def write_half():
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        write_half()
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["result.txt"]


def test_the_temporary_file_is_beside_the_target_and_has_its_suffix(tmp_path):
    target = tmp_path / "new" / "mesh.npz"
    with atomic_path(target) as temporary:
        assert temporary.parent == target.parent
        assert temporary.suffix == ".npz"
        assert not target.exists()
    assert target.exists()


def test_permissions_are_those_of_an_ordinary_file(tmp_path):
    write_text(tmp_path / "ours", "x")
    (tmp_path / "plain").write_text("x")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_directory_is_refused_by_name(tmp_path):
    with pytest.raises(IsADirectoryError, match=f"{tmp_path.name}.*is a directory"):
        write_text(tmp_path, "x")


def test_a_place_that_takes_no_files_is_named(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OSError, match=r"cannot write '.*file/mesh\.npz': "):
        write_text(tmp_path / "file" / "mesh.npz", "x")
