"""What is in a picture: a body, perhaps a garment, and the floor under them, with the light of the sky on each."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tryon_jax.mesh.normals import vertex_normals
from tryon_jax.mesh.topology import border_edges
from tryon_jax.render.light import sky_light

_FLOOR_HALF_WIDTH = 1.5
_FLOOR_SAMPLES = 96
# Metres between points of open borders from which distances are measured.
_BORDER_STEP = 0.003


NO_HEM = 10.0
"""Metres: farther from a hem than any cloth. Not infinite, since the shading takes means with weights of zero."""


@dataclass(frozen=True)
class Scene:
    """Triangles with what does not depend on the camera: normals, colours and the sky's light on both sides."""

    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    face_is_cloth: Bool[np.ndarray, " F"]
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


def linear_light(srgb: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values in 0 to 1 (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def srgb_value(linear: np.ndarray) -> np.ndarray:
    """sRGB value of linear light in 0 to 1."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def build_scene(
    body: tuple[np.ndarray, np.ndarray],
    garment: tuple[np.ndarray, np.ndarray] | None,
    body_colors: np.ndarray,
    garment_colors: np.ndarray,
) -> Scene:
    """Put body and garment together and light them by the sky.

    Args:
        body: vertices [V, 3] in metres and faces [F, 3].
        garment: the same of the garment, or None.
        body_colors: sRGB, one colour [3] or one for each vertex [V, 3].
        garment_colors: the same for the garment.
    """
    meshes = [body] if garment is None else [body, garment]
    counts = [len(v) for v, _ in meshes]
    starts = np.cumsum([0, *counts])
    vertices = np.concatenate([v.astype(np.float64) for v, _ in meshes])
    faces = np.concatenate([f.astype(np.int64) + start for (_, f), start in zip(meshes, starts, strict=False)])
    normals = np.concatenate([vertex_normals(v, f) for v, f in meshes])
    paints = zip((body_colors, garment_colors), counts, strict=False)
    colors = linear_light(np.concatenate([np.broadcast_to(paint, (count, 3)) for paint, count in paints]))

    border = np.full((len(vertices), 1), NO_HEM)
    # A map of measured colours is shown as it is, without hems.
    if garment is not None and garment_colors.ndim == 1:
        border[starts[1] :, 0] = _border_distance(garment[0].astype(np.float64), garment[1].astype(np.int64))

    floor = _floor(vertices)
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0]), (floor[..., 0].size, 3))
    cloth = slice(starts[1], None)
    light = sky_light(
        vertices,
        faces,
        np.concatenate([vertices, vertices[cloth], floor.reshape(-1, 3)]),
        np.concatenate([normals, -normals[cloth], up]),
    )
    front, back, floor_sky = np.split(light, [len(vertices), len(light) - len(up)])
    sky = np.stack([front, front], axis=1)
    sky[cloth, 1] = back
    return Scene(
        vertices=vertices,
        normals=normals,
        faces=faces,
        face_is_cloth=faces[:, 0] >= starts[1],
        colors=colors,
        sky=sky,
        border=border,
        floor=floor,
        floor_sky=floor_sky.reshape(floor.shape[:2]),
    )


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
