"""Clothes that are bound to MakeHuman's base mesh lie on the embedded bodies as on their own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tryon_jax.body import load_body
from tryon_jax.body.embedded import read_asset
from tryon_jax.body.makehuman import base_mesh_points
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.mesh.mhclo import read_binding
from tryon_jax.wear.bound import read_bound
from tryon_jax.wear.intake import take_in
from tryon_jax.wear.placement import Placing

BODY = load_body("female")
SKIN = np.asarray(BODY.v_template, np.float64)
SOURCE = read_asset("topology", ["source_vertex"])["source_vertex"]


def test_the_skin_is_where_it_is() -> None:
    points = base_mesh_points(BODY)
    np.testing.assert_allclose(points[SOURCE], SKIN, atol=3e-4)


def test_helpers_lie_round_the_body() -> None:
    # Eyes, teeth, hair, joints and the layers that clothes hang on: none is far away.
    distance = ClosedSurface(SKIN, np.asarray(BODY.faces)).closest(base_mesh_points(BODY)).distance
    assert np.abs(distance).max() < 0.3
    assert np.isfinite(distance).all()


def test_another_body_has_no_base_mesh() -> None:
    with pytest.raises(ValueError, match="'mine' is not one of the embedded bodies"):
        base_mesh_points(replace(BODY, faces=BODY.faces[:, [1, 2, 0]], name="mine"))


def write_belt(folder: Path, lift: float = 0.01) -> tuple[Path, np.ndarray]:
    """The skin of the hips, bound a centimetre above itself, in decimetres and somewhere else in its OBJ file."""
    faces = np.asarray(BODY.faces)
    inside = (SKIN[:, 1] > -0.12) & (SKIN[:, 1] < 0.12) & (np.abs(SKIN[:, 0]) < 0.25)
    chosen = faces[inside[faces].all(axis=1)]
    used, triangles = np.unique(chosen, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    normals = trimesh.Trimesh(SKIN, faces, process=False).vertex_normals[used]
    lines = ["o belt"] + [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in 10 * SKIN[used] + [1, 2, 3]]
    lines += [f"f {a} {b} {c}" for a, b, c in triangles + 1]
    (folder / "belt.obj").write_text("\n".join(lines) + "\n")
    bound = ["# a test", "basemesh hm08", "obj_file belt.obj", "z_depth 50", "verts 0"]
    for vertex, normal in zip(SOURCE[used], 10 * lift * normals, strict=True):
        bound.append(f"{vertex} {vertex} {vertex} 0.5 0.3 0.2 " + " ".join(f"{value:.6f}" for value in normal))
    (folder / "belt.mhclo").write_text("\n".join([*bound, "", "delete_verts", "3 - 5"]) + "\n")
    return folder / "belt.mhclo", SKIN[used] + lift * normals


def test_a_garment_lies_where_it_is_bound(tmp_path: Path) -> None:
    path, expected = write_belt(tmp_path)
    vertices, faces, uv = read_bound(path, BODY)
    assert uv is None
    assert len(vertices) == len(expected)
    assert faces.max() < len(vertices)
    np.testing.assert_allclose(np.sort(vertices, axis=0), np.sort(expected, axis=0), atol=1e-3)
    taken = take_in(path, BODY)
    assert any("by its binding" in remark for remark in taken.remarks)
    points, _ = taken.garment.joined()
    distance = ClosedSurface(SKIN, np.asarray(BODY.faces)).closest(points).distance
    # In the fold under the belly a centimetre along the normal is less from the skin beside it.
    assert distance.min() > 0.0
    assert np.median(distance) > 0.009


def test_what_the_binding_says_is_not_asked(tmp_path: Path) -> None:
    path, _ = write_belt(tmp_path)
    with pytest.raises(ValueError, match="says itself how it lies"):
        take_in(path, BODY, Placing(unit="cm"))


def test_offsets_follow_the_size_of_the_body(tmp_path: Path) -> None:
    path, _ = write_belt(tmp_path)
    first, second = SKIN[:, 1].argmin(), SKIN[:, 1].argmax()
    height = 10 * (SKIN[second, 1] - SKIN[first, 1])
    scaled = path.read_text().replace("z_depth 50", f"y_scale {SOURCE[first]} {SOURCE[second]} {height / 1.5:.4f}")
    before = read_binding(path).vertices(base_mesh_points(BODY))
    path.write_text(scaled)
    after = read_binding(path).vertices(base_mesh_points(BODY))
    offsets = read_binding(path).offsets
    np.testing.assert_allclose(after - before, offsets * [0.0, 0.5, 0.0], atol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("basemesh hm08", "basemesh other", "bound to 'other'"),
        ("verts 0\n", "verts 0\n1 2 3 0.5\n", "is no binding"),
        ("verts 0\n", "verts 0\n5\n", "binds .* vertices, but belt.obj has"),
        ("z_depth 50", "x_scale 1 2", "x_scale '1 2' is not two vertices"),
        ("belt.obj", "gone.obj", "gone.obj"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path, _ = write_belt(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        read_bound(path, BODY)


def test_a_vertex_that_the_base_mesh_lacks(tmp_path: Path) -> None:
    path, _ = write_belt(tmp_path)
    text = path.read_text()
    first = text.index("verts 0\n") + len("verts 0\n")
    path.write_text(text[:first] + "99999" + text[text.index(" ", first) :])
    with pytest.raises(ValueError, match="vertex 99999 of a base mesh that has 19158"):
        read_bound(path, BODY)
