"""Meshes from anywhere: what is repaired is said, what cannot be is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tryon_jax.mesh.quality import areas
from tryon_jax.mesh.repair import repair_mesh
from tryon_jax.mesh.topology import inspect_topology


def tube(rows: int = 7, columns: int = 16) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A skirt 0.6 m long and 0.2 m in radius, open above and below, cut open along one line: vertices, faces, uv."""
    turn, height = np.meshgrid(np.linspace(0, 2 * np.pi, columns + 1), np.linspace(0, 0.6, rows))
    vertices = np.stack([0.2 * np.sin(turn), height, 0.2 * np.cos(turn)], axis=-1).reshape(-1, 3)
    uv = np.stack([turn / (2 * np.pi), height], axis=-1).reshape(-1, 2)
    corner = (np.arange(rows - 1)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]), uv


VERTICES, FACES, UV = tube()
WELDED = 7 * 16


def outward(vertices: np.ndarray, faces: np.ndarray) -> bool:
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centre = corners.mean(axis=1)
    return bool(((normal * centre)[:, [0, 2]].sum(axis=1) > 0).all())


def test_a_clean_mesh_stays_as_it_is() -> None:
    clean = repair_mesh(VERTICES, FACES)
    again = repair_mesh(clean.vertices, clean.faces)
    assert again.repairs == ()
    np.testing.assert_array_equal(again.faces, clean.faces)
    np.testing.assert_array_equal(again.vertices, clean.vertices)


def test_texture_seams_are_welded_and_uv_kept() -> None:
    loaded = repair_mesh(VERTICES, FACES, UV)
    assert loaded.repairs == (f"welded {len(VERTICES)} vertices to {WELDED}",)
    (piece,) = loaded.pieces
    report = inspect_topology(piece.faces, len(piece.vertices))
    assert report.is_manifold
    assert (report.euler, report.loops) == (0, 2)
    assert piece.uv is not None
    assert piece.faces_uv is not None
    assert len(piece.uv) == len(UV)
    np.testing.assert_allclose(np.sort(piece.uv[piece.faces_uv], axis=0), np.sort(UV[FACES], axis=0))
    assert [len(loop) for loop in piece.loops] == [16, 16]
    assert outward(piece.vertices, piece.faces)


@settings(max_examples=15)
@given(st.lists(st.booleans(), min_size=len(FACES), max_size=len(FACES)))
def test_faces_are_turned_to_agree_and_look_outwards(flip: list[bool]) -> None:
    turned = np.where(np.array(flip)[:, None], FACES[:, [0, 2, 1]], FACES)
    loaded = repair_mesh(VERTICES, turned)
    assert outward(loaded.vertices, loaded.faces)
    assert inspect_topology(loaded.faces, WELDED).consistently_oriented
    said = [r for r in loaded.repairs if "look outwards" in r]
    assert said == ([f"turned {sum(flip)} faces to look outwards"] if any(flip) else [])


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("cm", 100.0), ("mm", 1000.0)])
def test_units_are_told_by_size(unit: str, scale: float) -> None:
    loaded = repair_mesh(VERTICES * scale, FACES)
    assert np.ptp(loaded.vertices[:, 1]) == pytest.approx(0.6)
    assert any(f"took lengths as {unit} " in r for r in loaded.repairs) == (unit != "m")


def test_a_unit_can_be_given() -> None:
    assert np.ptp(repair_mesh(VERTICES / 0.0254, FACES, unit="in").vertices[:, 1]) == pytest.approx(0.6)
    with pytest.raises(ValueError, match=r"mesh is 0\.6 cm across: a garment has 0\.24 to 2\.4 m"):
        repair_mesh(VERTICES, FACES, unit="cm")


def test_useless_faces_go() -> None:
    faces = np.concatenate([FACES, FACES[3:5], [[0, 0, 1], [2, 3, 2]]])
    vertices = np.concatenate([VERTICES, [[9, 9, 9.0]]])
    loaded = repair_mesh(vertices, faces)
    assert len(loaded.faces) == len(FACES)
    text = "; ".join(loaded.repairs)
    assert "dropped 2 faces without area" in text
    assert "dropped 2 doubled faces" in text
    assert "dropped 1 vertices that no face uses" in text


def test_pieces_are_separated_largest_first() -> None:
    small = 0.5 * VERTICES + [1.0, 0, 0]
    loaded = repair_mesh(np.concatenate([small, VERTICES]), np.concatenate([FACES, FACES + len(VERTICES)]))
    assert [round(float(areas(p.vertices, p.faces).sum()), 2) for p in loaded.pieces] == [0.75, 0.19]
    assert loaded.pieces[1].vertices[:, 0].min() > 0.8
    np.testing.assert_allclose(loaded.vertices[:, 1].max(), 0.6)
    assert loaded.repairs[-1] == f"split into 2 separate pieces of {WELDED}, {WELDED} vertices"


def test_sheets_that_touch_in_a_point_are_parted() -> None:
    upper = VERTICES * [1, 1, 1] + [0, 0.6, 0]
    lower = VERTICES * [1, 1, 1] + [0.4, 0, 0]
    # The two tubes touch where the rim of one stands on the rim of the other.
    vertices, faces = np.concatenate([upper, lower]), np.concatenate([FACES, FACES + len(VERTICES)])
    touch = np.flatnonzero(np.linalg.norm(vertices[:, None] - [0.2, 0.6, 0.0], axis=2).ravel() < 1e-9)
    assert len(touch) == 2
    loaded = repair_mesh(vertices, faces)
    assert "doubled 1 vertices where sheets only touch" in loaded.repairs
    assert len(loaded.pieces) == 2


def test_a_third_face_at_an_edge_is_refused() -> None:
    vertices = np.concatenate([VERTICES, [[0.5, 0.3, 0.5]]])
    a, b = FACES[40][:2]
    with pytest.raises(ValueError, match=r"my.obj has 1 edges with more than two faces, the first near \("):
        repair_mesh(vertices, np.concatenate([FACES, [[a, b, len(vertices) - 1]]]), name="my.obj")


def test_a_hole_is_refused() -> None:
    fine_vertices, fine_faces, _ = tube(31, 64)
    with pytest.raises(ValueError, match=r"has a hole of 3 edges, 0\.0\d\d m around, near \("):
        repair_mesh(fine_vertices, np.delete(fine_faces, 900, axis=0))


def test_a_moebius_strip_is_refused() -> None:
    turn = np.linspace(0, 2 * np.pi, 25)[:-1]
    across = np.array([-0.1, 0.1])
    radius = 0.4 + across[:, None] * np.cos(turn / 2)
    strip = np.stack([radius * np.cos(turn), radius * np.sin(turn), across[:, None] * np.sin(turn / 2)], axis=-1)
    here = np.arange(24)
    following = (here + 1) % 24
    low, high = here, here + 24
    next_low = np.where(here < 23, following, 24)
    next_high = np.where(here < 23, following + 24, 0)
    faces = np.concatenate([np.stack([low, next_low, high], 1), np.stack([high, next_low, next_high], 1)])
    with pytest.raises(ValueError, match="has one side only"):
        repair_mesh(strip.reshape(-1, 3), faces)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (VERTICES * 1e5, FACES, "no garment in metres"),
        (VERTICES * 0.01, FACES, r"is 0\.006 units across"),
        (np.where(VERTICES > 0.55, np.nan, VERTICES), FACES, "vertices of mesh must be finite"),
        (VERTICES, FACES[:, [0, 0, 1]], "no triangles with area"),
        (VERTICES[:0], FACES, r"vertices of mesh must be an array \[n, 3\] with n > 0, got shape \(0, 3\)"),
        (VERTICES, FACES[:0], r"faces of mesh must be an array \[n, 3\] with n > 0"),
        (VERTICES, FACES + 1, "must index its 119 vertices, but they run from 1 to 119"),
        (VERTICES, FACES - 1, "they run from -1 to 117"),
    ],
)
def test_bad_meshes(vertices: np.ndarray, faces: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        repair_mesh(vertices, faces)
