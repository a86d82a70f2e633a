"""Files of every kind that people hand in, each with what must come of it: fine, a word about it, or a refusal.

Refusals name the file and come before any drape; nothing here may raise anything but `ValueError` or `OSError`.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from wear.foreign_garments import BODY, FLOOR, ball, skirt, together, tshirt

from tryon_jax.wear.intake import take_in

SHIRT, FACES = tshirt()
SKIRT, SKIRT_FACES = skirt()
SKIN = np.asarray(BODY.v_template, float), np.asarray(BODY.faces)
Mesh = tuple[np.ndarray, np.ndarray]


def mesh_of(make: Callable[[], Mesh], suffix: str = ".ply") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / f"garment{suffix}"
        trimesh.Trimesh(*make(), process=False).export(path)
        return path

    return write


def text(content: str | bytes, suffix: str = ".obj") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / f"garment{suffix}"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def obj(vertices: np.ndarray, faces: np.ndarray) -> str:
    rows = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    return "\n".join(rows) + "\n"


def moved(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], Path]:
    return mesh_of(lambda: (change(SHIRT), FACES))


def third_face() -> Mesh:
    return np.concatenate([SHIRT, [[0.0, 0.2, 0.6]]]), np.concatenate([FACES, [[*FACES[400][:2], len(SHIRT)]]])


def unwelded() -> Mesh:
    return SHIRT[FACES].reshape(-1, 3), np.arange(FACES.size).reshape(-1, 3)


def punched() -> Mesh:
    return SHIRT, np.delete(FACES, np.flatnonzero((FACES[400][0] == FACES).any(axis=1))[:1], axis=0)


FINE = {
    "in metres": moved(lambda v: v),
    "skirt": mesh_of(lambda: (SKIRT, SKIRT_FACES)),
    "obj": mesh_of(lambda: (SHIRT, FACES), ".obj"),
    "glb": mesh_of(lambda: (SHIRT, FACES), ".glb"),
    "unused vertices": text(obj(np.concatenate([SHIRT, [[9.0, 9, 9]]]), FACES)),
    "obj of negative indices": text(obj(SHIRT, FACES - len(SHIRT) - 1)),
}
TOLD = {
    "decimetres": (moved(lambda v: 10 * v), "took lengths as dm"),
    "centimetres": (moved(lambda v: 100 * v), "took lengths as cm"),
    "millimetres": (moved(lambda v: 1000 * v), "took lengths as mm"),
    "inches": (moved(lambda v: v / 0.0254), "took lengths as in"),
    "z up": (moved(lambda v: v[:, [0, 2, 1]] * [1, -1, 1]), "vertical axis"),
    "z up in cm": (moved(lambda v: 100 * v[:, [0, 2, 1]] * [1, -1, 1]), "vertical axis"),
    "backwards": (moved(lambda v: v * [-1, 1, -1]), "turned it by 180"),
    "sideways": (moved(lambda v: v[:, [2, 1, 0]] * [1, 1, -1]), "turned it by 270"),
    "sideways the other way": (moved(lambda v: v[:, [2, 1, 0]] * [-1, 1, 1]), "turned it by 90"),
    "origin of SMPL": (moved(lambda v: v + [-0.002, -0.241, 0.029]), "SMPL's"),
    "on the floor": (moved(lambda v: v - [0, FLOOR, 0]), "the floor"),
    "on the floor in cm": (moved(lambda v: 100 * (v - [0, FLOOR, 0])), "the floor"),
    "somewhere": (moved(lambda v: v + [0.4, 0.7, 0.2]), "moved it by"),
    "arms at 30 degrees": (mesh_of(lambda: tshirt(arms=30.0)), "raised them"),
    "arms at 45 degrees in cm": (mesh_of(lambda: (100 * tshirt(arms=45.0)[0], FACES)), "raised them"),
    "with a body": (mesh_of(lambda: together(SKIN, (SHIRT, FACES))), "left out piece 1"),
    "with a ball": (mesh_of(lambda: together((SHIRT, FACES), ball((0.5, 0.5, 0), 0.05))), "left out piece 2"),
    "inside out": (mesh_of(lambda: (SHIRT, FACES[:, ::-1])), "look outwards"),
    "faces twice": (mesh_of(lambda: (SHIRT, np.concatenate([FACES, FACES[:9]]))), "doubled faces"),
    "faces of no area": (mesh_of(lambda: (SHIRT, np.concatenate([FACES, [[0, 0, 1]]]))), "without area"),
    "seams not welded": (
        mesh_of(lambda: (SHIRT[FACES].reshape(-1, 3), np.arange(FACES.size).reshape(-1, 3))),
        "welded",
    ),
    "two garments": (
        mesh_of(lambda: together((SHIRT, FACES), (SKIRT * [1.2, 1, 1.2], SKIRT_FACES))),
        "2 separate pieces",
    ),
}
REFUSED = {
    "empty": (text(""), "cannot be read|no triangles"),
    "noise": (text(b"\x00\xff\x13noise"), "cannot be read|no triangles|no corner"),
    "points only": (text("v 0 0 0\nv 1 0 0\n"), "cannot be read|no triangles"),
    "index too large": (text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n"), "names vertex '4' of 3"),
    "index zero": (text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n"), "names vertex '0' of 3"),
    "index of letters": (text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf a b c\n"), "names vertex 'a'"),
    "not a number": (text(obj(SHIRT, FACES).replace("v ", "v nan ", 1)), "must be finite|cannot be read"),
    "binary glTF of nonsense": (text(b"glTF nonsense", ".glb"), "cannot be read"),
    "Draco": (text(b"glTF KHR_draco_mesh_compression", ".glb"), "Draco"),
    "a binding of nothing": (text("basemesh hm08", ".mhclo"), "binds no vertices"),
    "fbx": (text("x", ".fbx"), "unknown mesh format"),
    "no suffix": (text("x", ""), "unknown mesh format"),
    "a triangle": (text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), "fits nowhere"),
    "kilometres": (moved(lambda v: 1e-3 * v), "no garment"),
    "micrometres": (moved(lambda v: 1e6 * v), "no garment"),
    "a toy's unit": (moved(lambda v: v / 0.058 + [0, 3, 0]), "m per unit it would come closest"),
    "a body alone": (mesh_of(lambda: SKIN), "no piece that is cloth"),
    "a ball alone": (mesh_of(lambda: ball((0, 0, 0), 0.4)), "no piece that is cloth"),
    "three faces at an edge": (mesh_of(third_face), "more than two faces"),
    "a small hole": (mesh_of(punched), "has a hole"),
}


def test_there_are_enough_of_them() -> None:
    assert len(FINE) + len(TOLD) + len(REFUSED) >= 40


@pytest.mark.parametrize("kind", FINE)
def test_fine(tmp_path: Path, kind: str) -> None:
    taken = take_in(FINE[kind](tmp_path), BODY)
    assert not any(word in " ".join(taken.remarks) for word in ("moved", "took", "turned it", "left out"))


@pytest.mark.parametrize("kind", TOLD)
def test_told(tmp_path: Path, kind: str) -> None:
    write, word = TOLD[kind]
    taken = take_in(write(tmp_path), BODY)
    assert any(word in remark for remark in taken.remarks), taken.remarks


@pytest.mark.parametrize("kind", REFUSED)
def test_refused(tmp_path: Path, kind: str) -> None:
    write, message = REFUSED[kind]
    with pytest.raises(ValueError, match=message):
        take_in(write(tmp_path), BODY)
