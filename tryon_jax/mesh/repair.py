"""Meshes that users bring: welded, oriented, brought to metres and split into pieces, with a list of repairs.

What cannot be repaired without guessing (holes, edges of three faces, a one-sided surface) is an error that says where.
"""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tryon_jax.checks import check_choice, check_finite
from tryon_jax.mesh.loaded_garment import LoadedGarment, Piece, border_length, refuse_holes
from tryon_jax.mesh.orientation import closed_volume, find_flips, turn_faces
from tryon_jax.mesh.quality import areas
from tryon_jax.mesh.topology import border_loops, directed_edges, hinges, inspect_topology, unique_edges
from tryon_jax.mesh.units import UNITS

GUESSED = ("m", "cm", "mm")
"""Units that are told by size: no garment can be meant in two of them. Others have to be named here; with a body to
measure by, `tryon_jax.wear.intake` tells them too."""

SIZE = (0.24, 2.4)
"""Largest extent of a garment, metres: anything else is in another unit, or is no garment."""

WELD = 1e-5
"""Vertices closer than this share of the mesh's size are one."""


def repair_mesh(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "V 2"] | None = None,
    unit: str = "auto",
    name: str = "mesh",
) -> LoadedGarment:
    """Make a clean mesh of triangles from anywhere; `mesh.reading.load_garment` says what is done and refused.

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
    flip = find_flips(faces, len(vertices), name)
    faces, faces_uv = turn_faces(faces, flip), turn_faces(faces_uv, flip)
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


def _check_arrays(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    for what, array in (("vertices", vertices), ("faces", faces)):
        if np.ndim(array) != 2 or np.shape(array)[1] != 3 or not len(array):
            raise ValueError(f"{what} of {name} must be an array [n, 3] with n > 0, got shape {np.shape(array)}")
    if not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(f"faces of {name} must be integers, got {faces.dtype}")
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= len(vertices):
        raise ValueError(f"faces of {name} must index its {len(vertices)} vertices, but they run from {low} to {high}")


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
    inside_out = closed_volume(vertices, faces, loops) < 0
    if inside_out:
        faces, faces_uv = faces[:, [0, 2, 1]], faces_uv[:, [0, 2, 1]]
        loops = [loop[::-1] for loop in loops]

    loops.sort(key=lambda loop: border_length(vertices, loop), reverse=True)
    own_uv = own_faces_uv = None
    if uv is not None:
        used_uv, inverse = np.unique(faces_uv, return_inverse=True)
        own_uv, own_faces_uv = uv[used_uv], inverse.reshape(faces.shape)
    report = inspect_topology(faces, len(vertices))
    if not report.is_manifold:
        raise ValueError(f"{name} is no clean surface after all repairs: {report}")
    return Piece(vertices, faces, own_uv, own_faces_uv, tuple(loops)), inside_out
