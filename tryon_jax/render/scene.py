"""What is in a picture: a body, perhaps a garment, and the floor under them, with the light of the sky on each."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tryon_jax.files.export import linear_light
from tryon_jax.mesh.normals import vertex_normals
from tryon_jax.mesh.topology import border_edges, directed_edges
from tryon_jax.render.light import Casters, sky_light
from tryon_jax.render.smooth_border import smooth_border

_FLOOR_HALF_WIDTH = 1.5
_FLOOR_SAMPLES = 96
# Metres between points of open borders from which distances are measured.
_BORDER_STEP = 0.003


NO_HEM = 10.0
"""Metres: farther from a hem than any cloth. Not infinite, since the shading takes means with weights of zero."""


@dataclass(frozen=True)
class Scene:
    """Triangles with what does not depend on the camera: normals, colours and the sky's light on both sides."""

    casters: Casters
    """What throws shadows: the meshes as they came, with a quarter of the triangles of the cloth that is seen."""

    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    face_is_cloth: Bool[np.ndarray, " F"]
    face_is_closed: Bool[np.ndarray, " F"]
    """True where only the front of a face can be seen."""
    colors: Float[np.ndarray, "V 3"]
    """Linear light."""
    sky: Float[np.ndarray, "V 2"]
    """Light of the sky on the front and on the back."""
    border: Float[np.ndarray, "V 1"]
    """Distance from the cloth's open borders, metres; `NO_HEM` where no hem is drawn."""
    floor: Float[np.ndarray, "N N 3"]
    """Points of the floor; rows along z, columns along x."""
    floor_sky: Float[np.ndarray, "N N"]
    """Light of the sky on them."""


def srgb_value(linear: np.ndarray) -> np.ndarray:
    """sRGB value of linear light in 0 to 1."""
    curve = 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, linear * 12.92, curve)


def build_scene(
    body: tuple[np.ndarray, np.ndarray],
    garment: tuple[np.ndarray, np.ndarray] | None,
    body_colors: np.ndarray,
    garment_colors: np.ndarray,
) -> Scene:
    """Put body and garment together and light them by the sky; the garment's borders become curves.

    Args:
        body: vertices [V, 3] in metres and faces [F, 3].
        garment: the same of the garment, or None.
        body_colors: sRGB, one colour [3] or one for each vertex [V, 3].
        garment_colors: the same for the garment.
    """
    meshes = [(v.astype(np.float64), f.astype(np.int64)) for v, f in ([body] if garment is None else [body, garment])]
    count = len(meshes[0][0])
    vertices, faces = _join(meshes)
    closed = np.arange(len(faces)) < (len(meshes[0][1]) if _is_closed(*meshes[0]) else 0)
    casters = Casters.of(vertices, faces, closed)
    normals = np.concatenate([vertex_normals(v, f) for v, f in meshes])
    floor = _floor(vertices)
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0]), (floor[..., 0].size, 3))
    light = sky_light(
        casters,
        np.concatenate([vertices, vertices[count:], floor.reshape(-1, 3)]),
        np.concatenate([normals, -normals[count:], up]),
    )
    front, back, floor_sky = np.split(light, [len(vertices), len(light) - len(up)])
    sky = np.repeat(front[:, None], 2, axis=1)
    colors = np.broadcast_to(body_colors, (count, 3))
    border = np.full((count, 1), NO_HEM)
    if garment is not None:
        # The sky's light changes little within a triangle: it is found before the cloth is cut finer.
        painted = np.broadcast_to(garment_colors, (len(garment[0]), 3))
        values = np.column_stack([painted, front[count:], back])
        points, triangles, values = smooth_border(*meshes[1], values)
        meshes[1] = points, triangles
        vertices, faces = _join(meshes)
        normals = np.concatenate([normals[:count], vertex_normals(points, triangles)])
        colors = np.concatenate([colors, values[:, :3]])
        sky = np.concatenate([sky[:count], values[:, 3:]])
        # A map of measured colours is shown as it is, without hems.
        hems = _border_distance(points, triangles) if garment_colors.ndim == 1 else np.full(len(points), NO_HEM)
        border = np.concatenate([border, hems[:, None]])
    cloth = np.arange(len(faces)) >= len(meshes[0][1])
    return Scene(
        casters=casters,
        vertices=vertices,
        normals=normals,
        faces=faces,
        face_is_cloth=cloth,
        face_is_closed=~cloth & closed[:1],
        colors=linear_light(colors),
        sky=sky,
        border=border,
        floor=floor,
        floor_sky=floor_sky.reshape(floor.shape[:2]),
    )


def _join(meshes: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0] + [len(v) for v, _ in meshes[:-1]])
    faces = [f + start for (_, f), start in zip(meshes, starts, strict=True)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


def _is_closed(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """True for a surface without border, counter-clockwise from outside, such as every body of the library."""
    start, end = directed_edges(faces).T
    there, back = np.sort(start * len(vertices) + end), np.sort(end * len(vertices) + start)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return bool((there == back).all() and np.einsum("fc,fc->", a, np.cross(b, c)) > 0)


def _border_distance(vertices: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, " V"]:
    """Distance of each vertex from hems, cuffs and neckline, metres; `NO_HEM` for closed cloth."""
    edges = border_edges(faces, len(vertices))
    if not len(edges):
        return np.full(len(vertices), NO_HEM)
    start, along = vertices[edges[:, 0]], vertices[edges[:, 1]] - vertices[edges[:, 0]]
    count = np.ceil(np.linalg.norm(along, axis=1) / _BORDER_STEP).astype(int) + 1
    edge = np.repeat(np.arange(len(edges)), count)
    part = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
    return cKDTree(start[edge] + part[:, None] * along[edge]).query(vertices)[0]


def _floor(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "N N 3"]:
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    ticks = np.linspace(-_FLOOR_HALF_WIDTH, _FLOOR_HALF_WIDTH, _FLOOR_SAMPLES)
    x, z = np.meshgrid(center[0] + ticks, center[2] + ticks)
    return np.stack([x, np.full_like(x, vertices[:, 1].min()), z], axis=-1)
