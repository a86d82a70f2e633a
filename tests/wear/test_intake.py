"""Garments from anywhere: unit, axes, facing, origin, arms and pieces are found, or the garment is refused."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from wear.foreign_garments import BODY, FLOOR, ball, over_the_skin, skirt, together, tshirt

from tryon_jax.mesh.pieces import choose_cloth, why_no_cloth
from tryon_jax.mesh.repair import clean_mesh
from tryon_jax.wear.arms import LoweredArms
from tryon_jax.wear.intake import take_in
from tryon_jax.wear.placement import Placing

SHIRT, FACES = tshirt()
SMPL_PELVIS = np.array([-0.002, -0.241, 0.029])


def write(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


def miss(vertices: np.ndarray, wanted: np.ndarray = SHIRT) -> float:
    """Largest distance between two garments of the same vertices in any order, metres."""
    from scipy.spatial import cKDTree

    return float(cKDTree(wanted).query(vertices)[0].max())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: v, ()),
        (lambda v: v * 10, ("took lengths as dm",)),
        (lambda v: v * 100, ("took lengths as cm",)),
        (lambda v: v * 1000, ("took lengths as mm",)),
        (lambda v: v / 0.0254, ("took lengths as in",)),
        (lambda v: v[:, [0, 2, 1]] * [1, -1, 1], ("took z as the vertical axis",)),
        (lambda v: v * [-1, 1, -1], ("turned it by 180 degrees",)),
        (lambda v: v[:, [2, 1, 0]] * [1, 1, -1], ("turned it by 270 degrees",)),
        (lambda v: v + SMPL_PELVIS, ("took its origin for SMPL's",)),
        (lambda v: v - [0, FLOOR, 0], ("the floor between the feet",)),
        (lambda v: 100 * (v - [0, FLOOR, 0])[:, [0, 2, 1]] * [1, -1, 1], ("cm", "took z", "the floor")),
        (lambda v: v + [0.3, 0.5, -0.2], ("moved it by (-30",)),
    ],
)
def test_units_axes_and_origins_are_found(tmp_path: Path, change, words: tuple[str, ...]) -> None:
    taken = take_in(write(tmp_path / "shirt.ply", change(SHIRT), FACES), BODY)
    for word in words:
        assert any(word in remark for remark in taken.remarks), taken.remarks
    if not words:
        assert taken.remarks == ()
    assert miss(taken.garment.vertices) < 0.012


def test_what_is_given_is_taken(tmp_path: Path) -> None:
    path = write(tmp_path / "shirt.ply", SHIRT / 0.058 + [0, 3, 0], FACES)
    with pytest.raises(
        ValueError, match=r"fits nowhere on the body in a usual unit .* m per unit it would come closest"
    ):
        take_in(path, BODY)
    assert miss(take_in(path, BODY, Placing(unit="0.058")).garment.vertices) < 0.012
    shifted = take_in(path, BODY, Placing(unit="0.058", offset=(0.0, -0.174, 0.0), up="y", turn=0, pose_of_garment="t"))
    assert miss(shifted.garment.vertices) < 1e-6


@pytest.mark.parametrize(
    ("placing", "message"),
    [
        (Placing(unit="yard"), r"unknown unit 'yard'; known: m, dm, cm, mm, in, or metres per unit"),
        (Placing(unit="-1"), r"unit = -1 m is outside its range"),
        (Placing(up="x"), "unknown up axis 'x'"),
        (Placing(turn=45), r"turn = 45 degrees is none of 0, 90, 180, 270"),
        (Placing(offset=(0.0, 40.0, 0.0)), r"offset up = 40 m is outside its range -3 to 3 m"),
        (Placing(pose_of_garment="b"), "pose of the garment must be t, a or degrees, got 'b'"),
        (Placing(pose_of_garment="120"), "pose of the garment = 120 degrees is outside its range"),
        (Placing(unit="mm"), r"0\.000\d+ m: a garment has 0\.24 to 2\.4 m"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, placing: Placing, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        take_in(write(tmp_path / "shirt.ply", SHIRT, FACES), BODY, placing)


@pytest.mark.parametrize("arms", [30.0, 45.0, 60.0])
def test_lowered_sleeves_are_found_and_raised(tmp_path: Path, arms: float) -> None:
    vertices, faces = tshirt(arms=arms)
    taken = take_in(write(tmp_path / "shirt.ply", vertices, faces), BODY)
    assert taken.placement.arms == arms
    # Smoothed weights round the armpits off.
    assert miss(taken.garment.vertices) < 0.06
    given = take_in(tmp_path / "shirt.ply", BODY, Placing(pose_of_garment=f"{arms:g}"))
    assert miss(given.garment.vertices) < 0.06


def test_arms_come_back_exactly_without_smoothing() -> None:
    lowered = LoweredArms(BODY, 50.0)
    raised = lowered.raise_garment(lowered.vertices, np.asarray(BODY.faces), rounds=0)
    np.testing.assert_allclose(raised, np.asarray(BODY.v_template), atol=1e-9)


def test_bodies_and_accessories_are_left_out(tmp_path: Path) -> None:
    body = np.asarray(BODY.v_template, float), np.asarray(BODY.faces)
    parts = together((SHIRT, FACES), ball((0.5, 0.4, 0.0), 0.05), body)
    taken = take_in(write(tmp_path / "scene.ply", 100 * parts[0], parts[1]), BODY)
    assert [len(piece.vertices) for piece in taken.garment.pieces] == [len(SHIRT)]
    said = [remark for remark in taken.remarks if "left out" in remark]
    assert said == [
        f"left out piece 1 ({len(body[0])} vertices): it is closed, as a body or an accessory is",
        "left out piece 3 (162 vertices): it is closed, as a body or an accessory is",
    ]
    assert miss(taken.garment.vertices) < 0.005
    again = take_in(tmp_path / "scene.ply", BODY, pieces=(2,))
    assert len(again.garment.vertices) == len(SHIRT)
    with pytest.raises(ValueError, match=r"piece = \[4\] must be different numbers from 1 to 3"):
        take_in(tmp_path / "scene.ply", BODY, pieces=(4,))


def test_a_body_with_holes_for_its_eyes_is_no_cloth() -> None:
    skin, faces = np.asarray(BODY.v_template, float), np.asarray(BODY.faces)
    eye = np.linalg.norm(skin - skin[np.argmax(skin[:, 2] + 10 * (skin[:, 1] > 0.6))], axis=1) < 0.03
    pieces = clean_mesh(skin, faces[~eye[faces].any(axis=1)]).pieces
    assert why_no_cloth(pieces) == ["is all but closed, as a body is"]
    with pytest.raises(ValueError, match="has no piece that is cloth: left out piece 1"):
        choose_cloth(pieces)


def test_buttons_are_too_small() -> None:
    turn = np.linspace(0, 2 * np.pi, 13)[:-1]
    rim = np.stack([0.01 * np.cos(turn), 0.01 * np.sin(turn), np.full(12, 0.2)], axis=1)
    button = np.concatenate([rim, [[0.0, 0.0, 0.2]]]), np.array([[k, (k + 1) % 12, 12] for k in range(12)])
    pieces = clean_mesh(*together((SHIRT, FACES), button)).pieces
    assert why_no_cloth(pieces) == ["", "is too small for cloth"]


@pytest.mark.parametrize("away", [0.02, 0.06])
def test_a_skirt_stays_where_it_is(tmp_path: Path, away: float) -> None:
    vertices, faces = skirt(away)
    taken = take_in(write(tmp_path / "skirt.ply", vertices, faces), BODY)
    assert miss(taken.garment.vertices, vertices) < 1e-5


def test_too_small_a_garment_is_told_by_how_much(tmp_path: Path) -> None:
    x, y, _ = np.asarray(BODY.v_template).T
    vertices, faces = over_the_skin((y > -0.1) & (y < 0.3) & (np.abs(x) < 0.25), away=-0.02)
    taken = take_in(write(tmp_path / "tube.ply", vertices, faces), BODY, Placing(offset=(0.0, 0.0, 0.0)))
    said = [remark for remark in taken.remarks if "does not reach round" in remark]
    assert any("at the waist 1" in remark and "cm are missing" in remark for remark in said), taken.remarks


def test_files_that_are_known_and_not_read(tmp_path: Path) -> None:
    squeezed = tmp_path / "squeezed.glb"
    squeezed.write_bytes(b'glTF{"extensionsRequired":["KHR_draco_mesh_compression"]}')
    with pytest.raises(ValueError, match="compressed with Draco, which is not supported: export it without"):
        take_in(squeezed, BODY)
