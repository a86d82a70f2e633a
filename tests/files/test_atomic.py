import os

import pytest

from tryon_jax.files.atomic import atomic_path, check_target, together, write_text


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


def test_files_that_belong_together_appear_together(tmp_path):
    write_text(tmp_path / "mesh", "old")

    def half():
        with together():
            write_text(tmp_path / "mesh", "new")
            assert (tmp_path / "mesh").read_text() == "old"
            write_text(tmp_path / "picture", "new")
            raise RuntimeError("killed between them")

    with pytest.raises(RuntimeError, match="killed"):
        half()
    assert os.listdir(tmp_path) == ["mesh"]
    with together():
        write_text(tmp_path / "mesh", "new")
        write_text(tmp_path / "picture", "new")
    assert sorted(os.listdir(tmp_path)) == ["mesh", "picture"]
    assert (tmp_path / "mesh").read_text() == "new"


def test_what_a_link_points_to_is_written(tmp_path):
    real = tmp_path / "real.txt"
    real.write_text("old")
    (tmp_path / "link.txt").symlink_to(real)
    write_text(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert real.read_text() == "new"


def test_a_name_at_the_limit_of_the_file_system_works(tmp_path):
    name = "x" * 251 + ".txt"
    write_text(tmp_path / name, "x")
    assert os.listdir(tmp_path) == [name]
    with pytest.raises(OSError, match=r"cannot write .*name too long"):
        check_target(tmp_path / ("x" * 300))


def test_a_full_disk_names_the_file(tmp_path):
    def full():
        with atomic_path(tmp_path / "mesh.glb"):
            raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match=r"cannot write '.*mesh\.glb': No space left on device"):
        full()
    assert os.listdir(tmp_path) == []


def test_targets_are_checked_before_work(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(NotADirectoryError, match="is a file and no folder"):
        check_target(tmp_path / "file" / "mesh.glb")
    with pytest.raises(IsADirectoryError, match="is a directory"):
        check_target(tmp_path)
    assert check_target(tmp_path / "new" / "mesh.glb") == (tmp_path / "new" / "mesh.glb").resolve()
    assert os.listdir(tmp_path) == ["file"]
