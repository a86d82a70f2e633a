import io

import numpy as np
import pytest
import trimesh

from tryon_jax.viewer import upload
from tryon_jax.viewer.upload import MAX_BYTES, read_upload


def sheet(count: int) -> trimesh.Trimesh:
    """A square piece of cloth of half a metre, with count x count vertices."""
    x, y = np.meshgrid(np.linspace(-0.25, 0.25, count), np.linspace(-0.25, 0.25, count))
    vertices = np.stack([x, y, np.full_like(x, 0.15)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(count - 1), np.arange(count - 1), indexing="ij")
    a = (i * count + j).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + count], -1), np.stack([a + 1, a + count + 1, a + count], -1)])
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("suffix", ["obj", "glb", "ply"])
def test_meshes_are_read(suffix):
    stream = io.BytesIO()
    sheet(6).export(stream, file_type=suffix)
    own = read_upload(f"C:\\fakepath\\cloth.{suffix.upper()}", stream.getvalue())
    assert own.name == f"cloth.{suffix.upper()}"
    assert len(own.loaded.vertices) == 36


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("big.obj", bytes(MAX_BYTES + 1), "'big.obj' has 20.0 MB, but at most 20 MB are taken"),
        ("scene.gltf", b"{}", "format of an uploaded mesh"),
        ("virus.exe", b"MZ", "format of an uploaded mesh"),
        ("broken.glb", b"glTF but not really", "broken.glb"),
        ("empty.obj", b"", "empty.obj"),
        ("../../etc/point.obj", b"v 0 0 0\n", "point.obj"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite"),
    ],
)
def test_bad_files_are_refused_by_name(name, content, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_upload(name, content)
    # No path of this computer is told to visitors.
    assert "/tmp" not in str(caught.value)
    assert "etc" not in str(caught.value)


def test_meshes_that_would_take_minutes_are_refused(monkeypatch):
    monkeypatch.setattr(upload, "MAX_VERTICES", 100)
    stream = io.BytesIO()
    sheet(11).export(stream, file_type="ply")
    with pytest.raises(ValueError, match="has 121 vertices, but at most 100 are taken"):
        read_upload("dense.ply", stream.getvalue())
