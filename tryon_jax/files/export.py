"""Meshes for other programs: GLB, OBJ, PLY and NPZ, with normals, texture coordinates and materials.

Texture coordinates are panel coordinates in metres, so that a fabric's print keeps its true size when its texture is
scaled to the size of one repeat. A garment has one per face corner (`uv`, `faces_uv`), since both sides of a seam are
one vertex in space and two points of the pattern. OBJ and NPZ keep that; GLB and PLY know one texture coordinate per
vertex, so vertices on seams are doubled there (with equal normals, so that nothing shows).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from tryon_jax.checks import check_finite
from tryon_jax.files.atomic import atomic_path, write_bytes, write_text
from tryon_jax.mesh.normals import vertex_normals
from tryon_jax.types import ArrayLike


@dataclass(frozen=True)
class Material:
    """A physically based material: sRGB base colour in 0 to 1, roughness in 0 to 1, never metallic."""

    color: tuple[float, float, float]
    roughness: float
    double_sided: bool
    """Whether the back of faces is seen, as inside a skirt."""


SKIN = Material(color=(0.76, 0.64, 0.565), roughness=0.6, double_sided=False)
CLOTH = Material(color=(0.29, 0.43, 0.58), roughness=0.9, double_sided=True)


@dataclass(frozen=True)
class Part:
    """One named mesh of a file; make it with `mesh_part`, which checks its arrays."""

    name: str
    vertices: Float[np.ndarray, "V 3"]
    """Metres, y up, +z front."""
    faces: Int[np.ndarray, "F 3"]
    material: Material
    uv: Float[np.ndarray, "U 2"] | None
    """Texture coordinates, metres on the panels."""
    faces_uv: Int[np.ndarray, "F 3"] | None
    """Index into `uv` of every face corner."""
    colors: Float[np.ndarray, "V 3"] | None
    """sRGB colour of every vertex in 0 to 1 in place of the material's colour, e.g. a map of fit."""


def mesh_part(
    name: str,
    vertices: Float[ArrayLike, "V 3"],
    faces: Int[ArrayLike, "F 3"],
    *,
    material: Material = CLOTH,
    uv: Float[ArrayLike, "U 2"] | None = None,
    faces_uv: Int[ArrayLike, "F 3"] | None = None,
    colors: Float[ArrayLike, "V 3"] | None = None,
) -> Part:
    """Check arrays and make a `Part` of them.

    `uv` without `faces_uv` means one texture coordinate per vertex.

    Args:
        name: Name of the part in the file.
        vertices: Metres.
        faces: Triangles.
        material: Colour and roughness.
        uv: Texture coordinates; without `faces_uv` one for each vertex.
        faces_uv: Entry of `uv` of every face corner.
        colors: sRGB colour of each vertex, 0 to 1.

    Raises:
        ValueError: numbers that are not finite, indices out of range, `faces_uv` without `uv`, or `uv` of neither kind.
    """
    points = np.asarray(check_finite(f"{name} vertices", np.asarray(vertices)), np.float32)
    triangles = _indices(f"{name} faces", np.asarray(faces), len(points))
    corners = None
    coordinates = None
    if uv is not None:
        coordinates = np.asarray(check_finite(f"{name} uv", np.asarray(uv)), np.float32)
        if faces_uv is not None:
            corners = _indices(f"{name} faces_uv", np.asarray(faces_uv), len(coordinates))
        elif len(coordinates) == len(points):
            corners = triangles
        else:
            raise ValueError(
                f"{name} uv has {len(coordinates)} entries for {len(points)} vertices: "
                "give one per vertex, or faces_uv with the entry of each face corner"
            )
    elif faces_uv is not None:
        raise ValueError(f"{name} has faces_uv but no uv for them to point to")
    paint = None
    if colors is not None:
        paint = np.asarray(np.clip(check_finite(f"{name} colors", np.asarray(colors)), 0.0, 1.0), np.float32)
    return Part(name, points, triangles, material, coordinates, corners, paint)


def _indices(name: str, indices: np.ndarray, count: int) -> np.ndarray:
    if indices.size and not 0 <= int(indices.min()) <= int(indices.max()) < count:
        raise ValueError(f"{name} must be indices in 0 to {count - 1}, but reach {indices.min()} to {indices.max()}")
    return indices.astype(np.int32)


def unit_normals(vertices: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, "V 3"]:
    """Unit normals; +y at vertices without a face, since the formats allow no zero."""
    normals = vertex_normals(vertices, faces).astype(np.float32)
    normals[~normals.any(axis=1)] = (0.0, 1.0, 0.0)
    return normals


@dataclass(frozen=True)
class Split:
    """A part with one texture coordinate per vertex."""

    vertex: np.ndarray
    """Which vertex of the part each is."""
    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None
    colors: np.ndarray | None


def split_at_seams(part: Part) -> Split:
    """Double the vertices that have several texture coordinates; normals are taken before, across the seams."""
    normals = unit_normals(part.vertices, part.faces)
    if part.uv is None or part.faces_uv is None:
        return Split(np.arange(len(part.vertices)), part.vertices, normals, part.faces, None, part.colors)
    keys = part.faces.astype(np.int64) * len(part.uv) + part.faces_uv
    unique, inverse = np.unique(keys, return_inverse=True)
    vertex, coordinate = np.divmod(unique, len(part.uv))
    return Split(
        vertex,
        part.vertices[vertex],
        normals[vertex],
        inverse.reshape(-1, 3).astype(np.int32),
        part.uv[coordinate],
        None if part.colors is None else part.colors[vertex],
    )


def write_glb(path: str | Path, parts: Sequence[Part]) -> None:
    """Write binary glTF 2.0: one named mesh with its own material for each part."""
    scene = trimesh.Scene()
    for part in parts:
        split = split_at_seams(part)
        rgba = [*((1.0, 1.0, 1.0) if split.colors is not None else part.material.color), 1.0]
        material = PBRMaterial(
            name=part.name,
            # glTF's factors are linear light; the material's colour is sRGB.
            baseColorFactor=[linear_light(c) for c in rgba[:3]] + [1.0],
            metallicFactor=0.0,
            roughnessFactor=part.material.roughness,
            doubleSided=part.material.double_sided,
        )
        uv = split.uv if split.uv is not None else np.zeros((len(split.vertices), 2), np.float32)
        visual = TextureVisuals(uv=uv, material=material)
        if split.colors is not None:
            linear = np.round(linear_light(split.colors) * 255).astype(np.uint8)
            alpha = np.full((len(linear), 1), 255, np.uint8)
            visual.vertex_attributes["color"] = np.concatenate([linear, alpha], axis=1)
        mesh = trimesh.Trimesh(
            split.vertices, split.faces, vertex_normals=split.normals, visual=visual, process=False, validate=False
        )
        scene.add_geometry(mesh, node_name=part.name, geom_name=part.name)
    data = export_glb(scene, include_normals=True)
    write_bytes(path, bytes(data))


def linear_light(srgb: np.ndarray | float) -> np.ndarray:
    """Linear light of an sRGB value (IEC 61966-2-1)."""
    value = np.asarray(srgb)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def write_obj(path: str | Path, parts: Sequence[Part]) -> None:
    """Write Wavefront OBJ with normals, a texture coordinate per face corner, and an MTL file beside it."""
    target = Path(path)
    lines = [f"mtllib {target.with_suffix('.mtl').name}"]
    materials = []
    first_vertex, first_uv = 1, 1
    for part in parts:
        lines += [f"o {part.name}", f"usemtl {part.name}"]
        points = part.vertices if part.colors is None else np.concatenate([part.vertices, part.colors], axis=1)
        lines += [f"v {' '.join(f'{x:.6f}' for x in row)}" for row in points.tolist()]
        normals = unit_normals(part.vertices, part.faces)
        lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in normals.tolist()]
        corner = (part.faces + first_vertex).tolist()
        if part.uv is None or part.faces_uv is None:
            lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in corner]
        else:
            lines += [f"vt {u:.6f} {v:.6f}" for u, v in part.uv.tolist()]
            corner_uv = (part.faces_uv + first_uv).tolist()
            pairs = zip(corner, corner_uv, strict=True)
            lines += [f"f {a}/{u}/{a} {b}/{v}/{b} {c}/{w}/{c}" for (a, b, c), (u, v, w) in pairs]
            first_uv += len(part.uv)
        first_vertex += len(part.vertices)
        red, green, blue = part.material.color
        shine = 1000 * (1 - part.material.roughness) ** 2
        materials.append(
            f"newmtl {part.name}\nKd {red:.4f} {green:.4f} {blue:.4f}\nKs 0.04 0.04 0.04\nNs {shine:.1f}\n"
        )
    write_text(target.with_suffix(".mtl"), "\n".join(materials))
    write_text(target, "\n".join(lines) + "\n")


def write_ply(path: str | Path, parts: Sequence[Part]) -> None:
    """Write one binary PLY mesh of all parts: normals, texture coordinates, colours, and the part of each face."""
    splits = [split_at_seams(part) for part in parts]
    counts = [len(s.vertices) for s in splits]
    vertex_type = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz", "s", "t")]
    vertex_type += [(name, "u1") for name in ("red", "green", "blue")]
    vertices = np.zeros(sum(counts), np.dtype(vertex_type))
    faces = np.zeros(sum(len(s.faces) for s in splits), np.dtype([("n", "u1"), ("v", "<i4", 3), ("part", "<i4")]))
    faces["n"] = 3
    at_vertex, at_face = 0, 0
    for number, (part, split) in enumerate(zip(parts, splits, strict=True)):
        rows = vertices[at_vertex : at_vertex + len(split.vertices)]
        uv = split.uv if split.uv is not None else np.zeros((len(split.vertices), 2))
        floats = np.concatenate([split.vertices, split.normals, uv], axis=1)
        for k, (name, _) in enumerate(vertex_type[:8]):
            rows[name] = floats[:, k]
        color = split.colors if split.colors is not None else np.tile(part.material.color, (len(split.vertices), 1))
        for k, name in enumerate(("red", "green", "blue")):
            rows[name] = np.round(color[:, k] * 255)
        block = faces[at_face : at_face + len(split.faces)]
        block["v"] = split.faces + at_vertex
        block["part"] = number
        at_vertex += len(split.vertices)
        at_face += len(split.faces)
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment part {number} {part.name}" for number, part in enumerate(parts)]
    header += [f"element vertex {len(vertices)}"]
    header += [f"property {'float' if kind == '<f4' else 'uchar'} {name}" for name, kind in vertex_type]
    header += [
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "property int part",
        "end_header",
    ]
    write_bytes(path, "\n".join(header).encode() + b"\n" + vertices.tobytes() + faces.tobytes())


def write_npz(path: str | Path, parts: Sequence[Part]) -> None:
    """Write NumPy arrays `<part>_vertices`, `<part>_faces` and, where there, `_uv`, `_faces_uv` and `_colors`."""
    arrays: dict[str, np.ndarray] = {}
    for part in parts:
        for field in ("vertices", "faces", "uv", "faces_uv", "colors"):
            value = getattr(part, field)
            if value is not None:
                arrays[f"{part.name}_{field}"] = value
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]


WRITERS: dict[str, Callable[[str | Path, Sequence[Part]], None]] = {
    ".glb": write_glb,
    ".obj": write_obj,
    ".ply": write_ply,
    ".npz": write_npz,
}


def check_suffix(path: str | Path) -> str:
    """Return the suffix of `path` in lower case, or raise `ValueError` naming the formats that can be written."""
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        raise ValueError(f"cannot write {str(path)!r}: the suffix {suffix!r} is none of {', '.join(WRITERS)}")
    return suffix


def write_mesh(path: str | Path, parts: Sequence[Part]) -> None:
    """Write `parts` in the format that the suffix of `path` names: .glb, .obj, .ply or .npz.

    Raises:
        ValueError: an unknown suffix, no part, or two parts of one name.
    """
    writer = WRITERS[check_suffix(path)]
    names = [part.name for part in parts]
    if not names or len(set(names)) != len(names):
        raise ValueError(f"cannot write {str(path)!r}: parts need distinct names, got {names}")
    writer(path, parts)
