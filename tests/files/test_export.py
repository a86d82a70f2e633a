import json
import struct

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from tryon_jax.files.export import CLOTH, SKIN, mesh_part, write_mesh
from tryon_jax.mesh.normals import vertex_normals

# Two unit squares side by side in space, folded along x = 1, cut apart along that fold in the pattern.
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, -1], [1, 1, -1]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [3, 0], [4, 0], [4, 1], [3, 1]], np.float32)
FACES_UV = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])


@pytest.fixture
def parts():
    sphere = trimesh.creation.icosphere(subdivisions=1)
    body = mesh_part("body", np.asarray(sphere.vertices), np.asarray(sphere.faces), material=SKIN)
    return [body, mesh_part("garment", VERTICES, FACES, uv=UV, faces_uv=FACES_UV)]


def test_glb_has_two_named_meshes_with_normals_uv_and_their_own_materials(parts, tmp_path):
    write_mesh(tmp_path / "a.glb", parts)
    data = (tmp_path / "a.glb").read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    tree = json.loads(data[20 : 20 + length])
    assert [mesh["name"] for mesh in tree["meshes"]] == ["body", "garment"]
    assert {"body", "garment"} <= {node.get("name") for node in tree["nodes"]}
    primitives = [mesh["primitives"][0] for mesh in tree["meshes"]]
    assert all({"POSITION", "NORMAL", "TEXCOORD_0"} <= set(p["attributes"]) for p in primitives)
    skin, cloth = (tree["materials"][p["material"]] for p in primitives)
    assert cloth["doubleSided"]
    assert not skin.get("doubleSided", False)
    assert cloth["pbrMetallicRoughness"]["roughnessFactor"] == CLOTH.roughness
    assert skin["pbrMetallicRoughness"]["baseColorFactor"][:3] == pytest.approx([0.538, 0.367, 0.279], abs=4e-3)


def test_glb_splits_seams_in_the_pattern_and_not_in_space(parts, tmp_path):
    write_mesh(tmp_path / "a.glb", parts)
    scene = trimesh.load(tmp_path / "a.glb", process=False)
    assert isinstance(scene, trimesh.Scene)
    garment = scene.geometry["garment"]
    assert len(garment.vertices) == len(UV)
    np.testing.assert_allclose(garment.triangles, VERTICES[FACES], atol=1e-6)
    np.testing.assert_allclose(garment.visual.uv[garment.faces], UV[FACES_UV], atol=1e-6)
    expected = vertex_normals(VERTICES, FACES)[FACES]
    np.testing.assert_allclose(garment.vertex_normals[garment.faces], expected, atol=1e-6)


def test_glb_keeps_vertex_colours(tmp_path):
    colors = np.linspace(0, 1, 18, dtype=np.float32).reshape(6, 3)
    write_mesh(tmp_path / "a.glb", [mesh_part("garment", VERTICES, FACES, uv=UV, faces_uv=FACES_UV, colors=colors)])
    garment = trimesh.load(tmp_path / "a.glb", process=False).geometry["garment"]
    stored = np.asarray(garment.visual.vertex_attributes["color"])[:, :3] / 255
    red_of_vertex_2 = stored[garment.faces[0, 2], 0]
    assert red_of_vertex_2 == pytest.approx(((6 / 17 + 0.055) / 1.055) ** 2.4, abs=3e-3)


def test_obj_keeps_vertices_whole_and_uv_per_corner(parts, tmp_path):
    write_mesh(tmp_path / "a.obj", parts)
    lines = (tmp_path / "a.obj").read_text().splitlines()
    start = lines.index("o garment")
    ours = lines[start:]
    assert sum(line.startswith("v ") for line in ours) == len(VERTICES)
    assert sum(line.startswith("vt ") for line in ours) == len(UV)
    corners = [[token.split("/") for token in line.split()[1:]] for line in ours if line.startswith("f ")]
    body_vertices = len(parts[0].vertices)
    assert [[int(c[0]) - 1 - body_vertices for c in face] for face in corners] == FACES.tolist()
    assert [[int(c[1]) - 1 for c in face] for face in corners] == FACES_UV.tolist()
    assert lines[0] == "mtllib a.mtl"
    assert (tmp_path / "a.mtl").read_text().count("newmtl") == 2


def test_obj_is_read_by_trimesh(parts, tmp_path):
    write_mesh(tmp_path / "a.obj", parts)
    scene = trimesh.load(tmp_path / "a.obj", process=False)
    area = sum(geometry.area for geometry in scene.geometry.values())
    assert area == pytest.approx(2 + trimesh.creation.icosphere(subdivisions=1).area, rel=1e-4)


def test_ply_is_one_mesh_with_the_part_of_each_face(parts, tmp_path):
    write_mesh(tmp_path / "a.ply", parts)
    mesh = trimesh.load(tmp_path / "a.ply", process=False)
    assert len(mesh.faces) == len(parts[0].faces) + len(FACES)
    np.testing.assert_allclose(mesh.triangles[-len(FACES) :], VERTICES[FACES], atol=1e-6)
    assert mesh.metadata["_ply_raw"]["face"]["data"]["part"].tolist() == [0] * len(parts[0].faces) + [1] * len(FACES)


def test_npz_returns_the_arrays(parts, tmp_path):
    write_mesh(tmp_path / "a.npz", parts)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as data:
        assert sorted(data) == [
            "body_faces",
            "body_vertices",
            *(f"garment_{k}" for k in ("faces", "faces_uv", "uv", "vertices")),
        ]
        np.testing.assert_array_equal(data["garment_vertices"], VERTICES)
        np.testing.assert_array_equal(data["garment_faces_uv"], FACES_UV)


def test_device_arrays_are_accepted():
    part = mesh_part("garment", jnp.asarray(VERTICES), jnp.asarray(FACES))
    assert isinstance(part.vertices, np.ndarray)


def test_unknown_suffix_names_the_formats(parts, tmp_path):
    with pytest.raises(ValueError, match=r"suffix '\.fbx' is none of \.glb, \.obj, \.ply, \.npz"):
        write_mesh(tmp_path / "a.fbx", parts)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"faces": FACES + 3}, r"garment faces must be indices in 0 to 5, but reach 3 to 8"),
        ({"vertices": np.full((6, 3), np.nan)}, r"garment vertices must be finite"),
        ({"uv": UV}, r"garment uv has 8 entries for 6 vertices"),
        ({"faces_uv": FACES_UV}, r"no uv for them to point to"),
        ({"uv": UV, "faces_uv": FACES_UV + 1}, r"garment faces_uv must be indices in 0 to 7, but reach 1 to 8"),
    ],
)
def test_bad_arrays_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        mesh_part("garment", **{"vertices": VERTICES, "faces": FACES, **change})


def test_two_parts_of_one_name_are_refused(parts, tmp_path):
    with pytest.raises(ValueError, match="distinct names"):
        write_mesh(tmp_path / "a.glb", [parts[0], parts[0]])


def test_a_vertex_without_a_face_still_has_a_unit_normal(tmp_path):
    points = np.concatenate([VERTICES, [[9.0, 9.0, 9.0]]])
    write_mesh(tmp_path / "a.obj", [mesh_part("garment", points, FACES)])
    normals = [line for line in (tmp_path / "a.obj").read_text().splitlines() if line.startswith("vn ")]
    assert normals[-1] == "vn 0.0000 1.0000 0.0000"
