"""Files of meshes from anywhere: every format, either axis up, and what cannot be read."""

from pathlib import Path

import numpy as np
import pytest

from tests.mesh.test_mesh_repair import FACES, UV, VERTICES, WELDED, outward
from tryon_jax.files.export import mesh_part, write_mesh
from tryon_jax.mesh.reading import load_garment
from tryon_jax.mesh.repair import repair_mesh
from tryon_jax.mesh.topology import directed_edges


@pytest.mark.parametrize("suffix", [".obj", ".glb", ".ply"])
@pytest.mark.parametrize("with_uv", [True, False])
def test_files_of_every_format(tmp_path: Path, suffix: str, with_uv: bool) -> None:
    clean = repair_mesh(VERTICES, FACES, UV).pieces[0]
    part = mesh_part(
        "skirt",
        clean.vertices,
        clean.faces,
        uv=clean.uv if with_uv else None,
        faces_uv=clean.faces_uv if with_uv else None,
    )
    path = tmp_path / f"skirt{suffix}"
    write_mesh(path, [part])
    piece = load_garment(path).pieces[0]
    assert len(piece.vertices) == WELDED
    assert {tuple(e) for e in np.round(piece.vertices, 4).tolist()} == {
        tuple(e) for e in np.round(clean.vertices.astype(np.float32).astype(float), 4).tolist()
    }
    assert len(directed_edges(piece.faces)) == 3 * len(FACES)
    assert outward(piece.vertices, piece.faces)
    if with_uv:
        assert piece.uv is not None
        assert len(np.unique(np.round(piece.uv, 5), axis=0)) == len(UV)


def test_z_up(tmp_path: Path) -> None:
    clean = repair_mesh(VERTICES + [0.0, 0.0, 0.05], FACES).pieces[0]
    blender = clean.vertices[:, [0, 2, 1]] * [1, -1, 1]
    write_mesh(tmp_path / "z.ply", [mesh_part("skirt", blender, clean.faces)])
    loaded = load_garment(tmp_path / "z.ply", up="z")
    np.testing.assert_allclose(loaded.vertices.min(axis=0), clean.vertices.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(loaded.vertices.max(axis=0), clean.vertices.max(axis=0), atol=1e-6)


@pytest.mark.parametrize("corner", ["9", "0", "-4", "x", "5/1/1"])
def test_faces_of_vertices_that_are_not_there(tmp_path: Path, corner: str) -> None:
    path = tmp_path / "bad.obj"
    path.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 {corner}\n")
    with pytest.raises(ValueError, match=r"bad\.obj', line 5: a face names vertex '.*' of 3 vertices"):
        load_garment(path)


def test_bad_files(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="garment: no file"):
        load_garment(tmp_path / "none.obj")
    other = tmp_path / "garment.fbx"
    other.write_bytes(b"x")
    with pytest.raises(ValueError, match=r"unknown mesh format '\.fbx'"):
        load_garment(other)
    broken = tmp_path / "broken.glb"
    broken.write_bytes(b"glTF nonsense")
    with pytest.raises(ValueError, match=r"cannot be read as \.glb"):
        load_garment(broken)
    points = tmp_path / "points.obj"
    points.write_text("v 0 0 0\nv 1 0 0\n")
    with pytest.raises(ValueError, match=r"has no triangles|cannot be read"):
        load_garment(points)
    with pytest.raises(ValueError, match="unknown unit 'yard'"):
        load_garment(points, unit="yard")
    with pytest.raises(ValueError, match="unknown up axis 'x'"):
        load_garment(points, up="x")
