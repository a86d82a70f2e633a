"""Files of meshes that users bring: their triangles as they are, or repaired."""

from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int

from tryon_jax.checks import check_choice, check_file
from tryon_jax.mesh.loaded_garment import LoadedGarment
from tryon_jax.mesh.repair import repair_mesh
from tryon_jax.mesh.units import UNITS

FORMATS = (".obj", ".glb", ".gltf", ".ply")
"""Suffixes of files that can be read."""


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
