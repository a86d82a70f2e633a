"""Meshes that users bring: read, welded, oriented, brought to metres and split into pieces, with a list of repairs.

What cannot be repaired without guessing (holes, edges of three faces, a one-sided surface) is an error that says where.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import trimesh
from jaxtyping import Float, Int
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from tryon_jax.checks import check_choice, check_file, check_finite
from tryon_jax.mesh.quality import areas
from tryon_jax.mesh.topology import border_loops, directed_edges, edge_keys, hinges, inspect_topology, unique_edges
from tryon_jax.mesh.units import UNITS

GUESSED = ("m", "cm", "mm")
"""Units that are told by size: no garment can be meant in two of them. Others have to be named here; with a body to
measure by, `tryon_jax.wear.intake` tells them too."""

SIZE = (0.24, 2.4)
"""Largest extent of a garment, metres: anything else is in another unit, or is no garment."""

FORMATS = (".obj", ".glb", ".gltf", ".ply")
"""Suffixes of files that can be read."""

WELD = 1e-5
"""Vertices closer than this share of the mesh's size are one."""

SMALLEST_OPENING = 0.08
"""Open borders shorter than this, metres, are holes: no arm fits through."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One clean, connected, consistently oriented surface."""

    vertices: Float[np.ndarray, "V 3"]
    """Metres, y up."""
    faces: Int[np.ndarray, "F 3"]
    """Counter-clockwise seen from outside."""
    uv: Float[np.ndarray, "U 2"] | None
    """Texture coordinates as in the file, or None."""
    faces_uv: Int[np.ndarray, "F 3"] | None
    """Triangles as indices into `uv`, or None."""
    loops: tuple[Int[np.ndarray, " _"], ...]
    """Open borders, longest first."""


@dataclass(frozen=True, eq=False)
class LoadedGarment:
    """What `load_garment` found in a file."""

    pieces: tuple[Piece, ...]
    """Connected pieces, the largest area first."""
    repairs: tuple[str, ...]
    """What was changed, one sentence each; empty for a file that was clean."""

    @property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Vertices of the largest piece, metres."""
        return self.pieces[0].vertices

    @property
    def faces(self) -> Int[np.ndarray, "F 3"]:
        """Triangles of the largest piece."""
        return self.pieces[0].faces

    def joined(self) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
        """Vertices, metres, and triangles of all pieces together."""
        starts = np.cumsum([0, *(len(piece.vertices) for piece in self.pieces[:-1])])
        faces = [piece.faces + start for piece, start in zip(self.pieces, starts, strict=True)]
        return np.concatenate([piece.vertices for piece in self.pieces]), np.concatenate(faces)

    def moved(self, vertices: Float[np.ndarray, "V 3"]) -> "LoadedGarment":
        """The same with other vertices, as `joined` lists them."""
        ends = np.cumsum([len(piece.vertices) for piece in self.pieces])
        parts = np.split(np.asarray(vertices), ends[:-1])
        pieces = [replace(piece, vertices=part) for piece, part in zip(self.pieces, parts, strict=True)]
        return replace(self, pieces=tuple(pieces))

    def texture(self) -> tuple[Float[np.ndarray, "U 2"], Int[np.ndarray, "F 3"]] | tuple[None, None]:
        """Texture coordinates of all pieces together and their use by face corners; nothing where a piece has none."""
        uv = [piece.uv for piece in self.pieces if piece.uv is not None]
        faces_uv = [piece.faces_uv for piece in self.pieces if piece.faces_uv is not None]
        if not len(uv) == len(faces_uv) == len(self.pieces):
            return None, None
        starts = np.cumsum([0, *(len(one) for one in uv[:-1])])
        return np.concatenate(uv), np.concatenate([f + start for f, start in zip(faces_uv, starts, strict=True)])


def load_garment(path: str | Path, unit: str = "auto", up: str = "y") -> LoadedGarment:
    """Read a garment from an OBJ, GLB, glTF or PLY file and make it a clean mesh, or say why that is not possible.

    Done in this order: faces without area and doubled faces go; vertices at one place (both sides of a texture seam)
    are welded, with UVs kept per corner; vertices where two sheets touch are doubled; faces are turned to agree and to
    look outwards; lengths are brought to metres; connected pieces are separated.

    Args:
        path: the file.
        unit: "m", "cm", "mm", "in", or "auto" to tell metres, centimetres and millimetres by the size of the whole.
        up: the file's vertical axis, "y" or "z" (+z up, −y front as in Blender).

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: for another format, a file without triangles, coordinates that are not finite, a size that is no
            garment's in any unit, edges with more than two faces, holes, or a surface with one side only.
    """
    check_choice("unit", unit, ("auto", *UNITS))
    check_choice("up axis", up, ("y", "z"))
    vertices, faces, uv = read_triangles(path)
    if up == "z":
        vertices = vertices[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    return repair_mesh(vertices, faces, uv, unit=unit, name=str(Path(path).expanduser()))


def read_triangles(
    path: str | Path,
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"], Float[np.ndarray, "V 2"] | None]:
    """All triangles of an OBJ, GLB, glTF or PLY file as they are: vertices in its units, faces, and uv where given.

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: for another format, a file that cannot be read, or one without triangles.
    """
    file = check_file("garment", path)
    suffix = file.suffix.lower()
    if suffix == ".mhclo":
        raise ValueError(
            f"garment {str(file)!r} is bound to a body: `tryon drape --garment` and `Session.bring` put it on one; or "
            "give the .obj beside it, which is placed by its shape"
        )
    check_choice("mesh format", suffix, FORMATS)
    if suffix in (".glb", ".gltf") and b"KHR_draco_mesh_compression" in file.read_bytes():
        raise ValueError(f"garment {str(file)!r} is compressed with Draco, which is not supported: export it without")
    if suffix == ".obj":
        _check_obj(file)
    try:
        # An OBJ's materials are other files and are not wanted; of a GLB trimesh reads UVs with the material only.
        loaded = trimesh.load_scene(file, process=False, skip_materials=suffix == ".obj")
    except Exception as error:  # Loaders raise whatever their parsers do.
        raise ValueError(f"garment {str(file)!r} cannot be read as {suffix}: {error}") from error
    return _gather(loaded, str(file))


def _check_obj(file: Path) -> None:
    """Refuse faces of vertices that are not there: trimesh counts such indices from the end, or fails without words."""
    with file.open("rb") as stream:
        count = sum(line.startswith((b"v ", b"v\t")) for line in map(bytes.lstrip, stream))
    with file.open("rb") as stream:
        for number, line in enumerate(stream, start=1):
            words = line.split()
            for corner in words[1:] if words and words[0] == b"f" else ():
                text = corner.split(b"/")[0]
                if not text.lstrip(b"-").isdigit() or not 1 <= abs(int(text)) <= count:
                    shown = text.decode(errors="replace")
                    raise ValueError(
                        f"garment {str(file)!r}, line {number}: a face names vertex {shown!r} of {count} vertices"
                    )


def _check_arrays(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    for what, array in (("vertices", vertices), ("faces", faces)):
        if np.ndim(array) != 2 or np.shape(array)[1] != 3 or not len(array):
            raise ValueError(f"{what} of {name} must be an array [n, 3] with n > 0, got shape {np.shape(array)}")
    if not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(f"faces of {name} must be integers, got {faces.dtype}")
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= len(vertices):
        raise ValueError(f"faces of {name} must index its {len(vertices)} vertices, but they run from {low} to {high}")


def _gather(scene: trimesh.Scene, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """All meshes of a scene at their places, as one."""
    vertices, faces, uvs, start = [], [], [], 0
    for node in scene.graph.nodes_geometry:
        transform, key = scene.graph[node]
        mesh = scene.geometry[key]
        if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
            continue
        vertices.append(trimesh.transform_points(np.asarray(mesh.vertices, float), transform))
        faces.append(np.asarray(mesh.faces, np.int64) + start)
        start += len(mesh.vertices)
        uv = getattr(mesh.visual, "uv", None)
        uvs.append(None if uv is None or len(uv) != len(mesh.vertices) else np.asarray(uv, float))
    if not faces:
        raise ValueError(f"garment {name!r} has no triangles")
    all_uv = None if any(u is None for u in uvs) else np.concatenate(uvs)
    return np.concatenate(vertices), np.concatenate(faces), all_uv


def repair_mesh(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "V 2"] | None = None,
    unit: str = "auto",
    name: str = "mesh",
) -> LoadedGarment:
    """Make a clean mesh of triangles from anywhere; see `load_garment` for what is done and what is refused.

    Args:
        vertices: In the file's unit.
        faces: Triangles.
        uv: Texture coordinates of the vertices.
        unit: Name of the unit (`mesh.units.UNITS`); "auto" finds one in which the mesh has the size of a garment.
        name: What messages call the mesh.

    Raises:
        ValueError: as `load_garment`, and for arrays of other shapes, without triangles, or with indices out of range.
    """
    _check_arrays(vertices, faces, name)
    vertices = check_finite(f"vertices of {name}", vertices).astype(float)
    repairs: list[str] = []
    check_choice("unit", unit, ("auto", *UNITS))
    vertices = vertices * _scale(vertices[np.unique(faces)], unit, name, repairs)
    clean = clean_mesh(vertices, faces, uv, name)
    for piece in clean.pieces:
        refuse_holes(piece, name)
    return LoadedGarment(clean.pieces, (*repairs, *clean.repairs))


def clean_mesh(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "V 2"] | None = None,
    name: str = "mesh",
) -> LoadedGarment:
    """What `repair_mesh` does in any unit of length: everything but the unit and the search for holes.

    Args:
        vertices: In any unit.
        faces: Triangles.
        uv: Texture coordinates of the vertices.
        name: What messages call the mesh.

    Raises:
        ValueError: arrays of other shapes or with indices out of range, coordinates that are not finite, no triangles,
            edges with more than two faces, or a surface with one side only.
    """
    _check_arrays(vertices, faces, name)
    vertices = check_finite(f"vertices of {name}", vertices).astype(float)
    repairs: list[str] = []
    faces_uv = faces.astype(np.int64)
    vertices, faces = _weld(vertices, faces_uv, repairs)
    keep = _worthwhile(vertices, faces, repairs)
    faces, faces_uv = faces[keep], faces_uv[keep]
    if not len(faces):
        raise ValueError(f"{name} has no triangles with area")
    _refuse_crowded_edges(vertices, faces, name)
    flip = _flips(faces, len(vertices), name)
    faces, faces_uv = _turn(faces, flip), _turn(faces_uv, flip)
    vertices, faces = _part_touching(vertices, faces, repairs)
    label = connected_components(_vertex_graph(faces, len(vertices)), directed=False)[1][faces[:, 0]]
    pieces, turned = [], int(flip.sum())
    for k in np.unique(label):
        mine = label == k
        piece, inside_out = _finish(vertices, faces[mine], uv, faces_uv[mine], name)
        turned += len(piece.faces) - 2 * int(flip[mine].sum()) if inside_out else 0
        pieces.append(piece)
    if turned:
        repairs.append(f"turned {turned} faces to look outwards")
    pieces.sort(key=lambda p: -areas(p.vertices, p.faces).sum())
    if len(pieces) > 1:
        sizes = ", ".join(str(len(p.vertices)) for p in pieces)
        repairs.append(f"split into {len(pieces)} separate pieces of {sizes} vertices")
    return LoadedGarment(tuple(pieces), tuple(repairs))


def _scale(used: np.ndarray, unit: str, name: str, repairs: list[str]) -> float:
    size = float(np.ptp(used, axis=0).max())
    if unit == "auto":
        fits = [u for u in GUESSED if SIZE[0] <= size * UNITS[u] < SIZE[1]]
        if not fits:
            raise ValueError(
                f"{name} is {size:g} units across: no garment in metres ({SIZE[0]:g} to {SIZE[1]:g}), centimetres or "
                "millimetres; give its unit"
            )
        unit = fits[0]
    elif not SIZE[0] <= size * UNITS[unit] < SIZE[1]:
        raise ValueError(f"{name} is {size:g} {unit} across: a garment has {SIZE[0]:g} to {SIZE[1]:g} m")
    if unit != "m":
        repairs.append(f"took lengths as {unit} and brought them to metres ({size:g} {unit} across)")
    return UNITS[unit]


def _weld(vertices: np.ndarray, faces: np.ndarray, repairs: list[str]) -> tuple[np.ndarray, np.ndarray]:
    used = np.unique(faces)
    points = vertices[used]
    pairs = cKDTree(points).query_pairs(WELD * float(np.ptp(points, axis=0).max()), output_type="ndarray")
    graph = sp.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (len(used), len(used)))
    _, label = connected_components(graph, directed=False)
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    index = np.zeros(len(vertices), np.int64)
    index[used] = rank[inverse]
    if len(first) < len(used):
        repairs.append(f"welded {len(used)} vertices to {len(first)}")
    if len(used) < len(vertices):
        repairs.append(f"dropped {len(vertices) - len(used)} vertices that no face uses")
    return points[first[order]], index[faces]


def _worthwhile(vertices: np.ndarray, faces: np.ndarray, repairs: list[str]) -> np.ndarray:
    """Faces with three different corners and an area, each once."""
    flat = areas(vertices, faces) <= 1e-12 * float(np.ptp(vertices, axis=0).max()) ** 2
    flat |= (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    rows = np.sort(faces, axis=1)
    _, first = np.unique(rows, axis=0, return_index=True)
    twin = np.ones(len(faces), bool)
    twin[first] = False
    if flat.any():
        repairs.append(f"dropped {int(flat.sum())} faces without area")
    if (twin & ~flat).any():
        repairs.append(f"dropped {int((twin & ~flat).sum())} doubled faces")
    return ~(flat | twin)


def _refuse_crowded_edges(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    edges, counts = unique_edges(faces, len(vertices))
    crowded = edges[counts > 2]
    if len(crowded):
        x, y, z = vertices[crowded[0]].mean(axis=0)
        raise ValueError(
            f"{name} has {len(crowded)} edges with more than two faces, the first near ({x:.3f}, {y:.3f}, {z:.3f}): "
            "separate the sheets that meet there"
        )


def _flips(faces: np.ndarray, count: int, name: str) -> np.ndarray:
    """Which faces to turn so that neighbours agree, the fewer in each piece."""
    half = directed_edges(faces)
    face_of = np.tile(np.arange(len(faces)), 3)
    keys = edge_keys(half, count)
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    first, second = order[same], order[same + 1]
    disagree = half[first, 0] == half[second, 0]
    a, b = face_of[first], face_of[second]
    total = len(faces)
    graph = sp.coo_matrix((np.ones(len(a)), (a, b)), (total, total)).tocsr()
    graph = graph + graph.T
    # Entries 1 and 2 tell edges that agree from those that do not; two faces never share more than one edge here.
    weight = sp.coo_matrix((1.0 + disagree, (a, b)), (total, total)).tocsr()
    weight = weight.maximum(weight.T)
    flip = np.zeros(total, bool)
    pieces, label = connected_components(graph, directed=False)
    for k in range(pieces):
        root = int(np.argmax(label == k))
        visited, before = breadth_first_order(graph, root, directed=False)
        for face in visited[1:]:
            flip[face] = flip[before[face]] ^ (weight[before[face], face] == 2.0)
        mine = label == k
        if flip[mine].mean() > 0.5:
            flip[mine] = ~flip[mine]
    if (flip[a] ^ flip[b] ^ disagree).any():
        raise ValueError(f"{name} has one side only (like a Möbius strip): its faces cannot be turned to agree")
    return flip


def _turn(faces: np.ndarray, flip: np.ndarray) -> np.ndarray:
    return np.where(flip[:, None], faces[:, [0, 2, 1]], faces)


def _part_touching(vertices: np.ndarray, faces: np.ndarray, repairs: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Double vertices where two sheets touch in a point: each fan of faces gets its own."""
    quads, pairs = hinges(faces, len(vertices))

    def corner(face: np.ndarray, vertex: np.ndarray) -> np.ndarray:
        return 3 * face + np.argmax(faces[face] == vertex[:, None], axis=1)

    rows = np.concatenate([corner(pairs[:, 0], quads[:, 0]), corner(pairs[:, 0], quads[:, 1])])
    cols = np.concatenate([corner(pairs[:, 1], quads[:, 0]), corner(pairs[:, 1], quads[:, 1])])
    graph = sp.coo_matrix((np.ones(len(rows)), (rows, cols)), (faces.size, faces.size))
    _, fan = connected_components(graph, directed=False)
    _, first, inverse = np.unique(fan, return_index=True, return_inverse=True)
    owner = faces.ravel()[first]
    order = np.argsort(owner, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    extra = len(owner) - len(np.unique(owner))
    if extra:
        repairs.append(f"doubled {extra} vertices where sheets only touch")
    return vertices[owner[order]], rank[inverse].reshape(faces.shape)


def _vertex_graph(faces: np.ndarray, count: int) -> sp.coo_matrix:
    half = directed_edges(faces)
    return sp.coo_matrix((np.ones(len(half)), (half[:, 0], half[:, 1])), (count, count))


def _finish(
    vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray | None, faces_uv: np.ndarray, name: str
) -> tuple[Piece, bool]:
    """One piece with its own numbering, looking outwards; says whether it was inside out."""
    used, inverse = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], inverse.reshape(faces.shape)
    loops = border_loops(faces, len(vertices))
    inside_out = _closed_volume(vertices, faces, loops) < 0
    if inside_out:
        faces, faces_uv = faces[:, [0, 2, 1]], faces_uv[:, [0, 2, 1]]
        loops = [loop[::-1] for loop in loops]

    loops.sort(key=lambda loop: _around(vertices, loop), reverse=True)
    own_uv = own_faces_uv = None
    if uv is not None:
        used_uv, inverse = np.unique(faces_uv, return_inverse=True)
        own_uv, own_faces_uv = uv[used_uv], inverse.reshape(faces.shape)
    report = inspect_topology(faces, len(vertices))
    if not report.is_manifold:
        raise ValueError(f"{name} is no clean surface after all repairs: {report}")
    return Piece(vertices, faces, own_uv, own_faces_uv, tuple(loops)), inside_out


def _around(vertices: np.ndarray, loop: np.ndarray) -> float:
    """Length of an open border."""
    return float(np.linalg.norm(vertices[loop] - vertices[np.roll(loop, 1)], axis=1).sum())


def refuse_holes(piece: Piece, name: str) -> None:
    """Raise `ValueError` for an open border of a piece in metres that is too short for an arm."""
    for loop in piece.loops:
        length = _around(piece.vertices, loop)
        if length < SMALLEST_OPENING:
            x, y, z = piece.vertices[loop].mean(axis=0)
            raise ValueError(
                f"{name} has a hole of {len(loop)} edges, {length:.3f} m around, near ({x:.3f}, {y:.3f}, {z:.3f}) m: "
                "fill it"
            )


def _closed_volume(vertices: np.ndarray, faces: np.ndarray, loops: list[np.ndarray]) -> float:
    """Signed volume after closing each open loop with a fan to its centre."""

    def volume(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6

    total = volume(vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]])
    for loop in loops:
        ring = vertices[loop]
        centre = np.broadcast_to(ring.mean(axis=0), ring.shape)
        total += volume(np.roll(ring, -1, axis=0), ring, centre)
    return total
