"""Pixels of one view: skin, cloth and floor under the sky, a key lamp and a rim lamp."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter, map_coordinates

from tryon_jax.render.camera import Camera
from tryon_jax.render.light import Lamp
from tryon_jax.render.raster import Fragments, rasterize
from tryon_jax.render.scene import Scene

_SKY = 0.50
_KEY = 1.22
_RIM = 0.5
# Light scatters under the skin, red light the farthest: shadows have soft, warm edges.
_SKIN_WRAP = np.array([0.30, 0.16, 0.11], np.float32)
_CLOTH_WRAP = np.array([0.05, 0.05, 0.05], np.float32)
# The inside of cloth beside its outside.
_INSIDE = 0.45
# Hems are turned up and stitched: a double layer is a little darker than its neighbourhood, its stitches more so.
_HEM_WIDTH = 0.016
_HEM_SHADE, _STITCH_SHADE = 0.035, 0.20
_STITCH_WIDTH = 0.0011
# Coverage is sampled in this many rows of each pixel, once in each, at these distances from the pixel's middle: no two
# samples share a row or a column, so that edges of every direction are smooth. Each kind of surface is shaded once.
_SAMPLES = 4
_SHIFTS = (-0.125, 0.375, -0.375, 0.125)
# Rows beyond those where the floor is dark: a step of the floor's grid, seen from so low.
_ROWS_MORE = 8


@dataclass(frozen=True)
class Frame:
    """The part of the plane through the camera's target that a picture shows."""

    left: float
    """Metres."""
    top: float
    """Metres."""
    pixel: float
    """Metres per pixel."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""


def render_view(
    scene: Scene, camera: Camera, frame: Frame, background: Float[np.ndarray, "H W 3"]
) -> Float[np.ndarray, "H W 3"]:
    """Linear light of the scene before `background`.

    Args:
        scene: What to draw.
        camera: From where.
        frame: Which part, in how many pixels.
        background: Linear light behind it.
    """
    key = Lamp.of(scene.casters, _from_camera(camera, -0.80, 0.70, 0.50), radius=0.13, samples=10)
    rim = Lamp.of(scene.casters, _from_camera(camera, 0.85, 0.45, -0.55), radius=0.0, samples=1)

    screen = camera.project(scene.vertices)
    screen[:, 0] = (screen[:, 0] - frame.left) / frame.pixel
    screen[:, 1] = (frame.top - screen[:, 1]) / frame.pixel * _SAMPLES
    a, b, c = (screen[scene.faces[:, k], :2] for k in range(3))
    turned = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) > (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    shown = ~(turned & scene.face_is_closed)
    faces = scene.faces[shown]
    fragments = rasterize(screen, faces, frame.height * _SAMPLES, frame.width, _SHIFTS)
    # 0: body, 1: cloth, 2: inside of cloth; the last entry is what face -1 finds.
    kinds = np.append(np.where(scene.face_is_cloth, 1 + turned, 0)[shown], 3).astype(np.uint8)

    picture = background * _floor_shade(scene, camera, frame, key)[..., None]
    samples = fragments.face.reshape(frame.height, _SAMPLES, frame.width)
    row, column = np.nonzero((samples >= 0).any(axis=1))
    covered = kinds[samples[row, :, column]]
    light = picture[row, column] * (covered == 3).mean(axis=1, keepdims=True, dtype=np.float32)
    for kind in range(3):
        inside = covered == kind
        of_kind = np.flatnonzero(inside.any(axis=1))
        if len(of_kind):
            inside = inside[of_kind]
            sample = inside.argmax(axis=1)
            at = row[of_kind] * _SAMPLES + sample, column[of_kind]
            surface = _surface(scene, faces, camera, key, rim, fragments, *at, kind, frame.pixel)
            light[of_kind] += surface * inside.mean(axis=1, keepdims=True, dtype=np.float32)
    picture[row, column] = light
    return picture


def _from_camera(camera: Camera, right: float, up: float, towards: float) -> np.ndarray:
    direction = np.array([right, up, towards]) @ camera.axes
    return direction / np.linalg.norm(direction)


def _surface(
    scene: Scene,
    faces: Int[np.ndarray, "F 3"],
    camera: Camera,
    key: Lamp,
    rim: Lamp,
    fragments: Fragments,
    row: Int[np.ndarray, " N"],
    column: Int[np.ndarray, " N"],
    kind: int,
    pixel: float,
) -> Float[np.ndarray, "N 3"]:
    """Linear light that samples of one kind of surface send to the camera."""
    weights = fragments.corner_weights(faces, row, column).astype(np.float32)
    corners = faces[fragments.face[row, column]]
    parts = [scene.vertices, scene.normals, scene.colors, scene.sky, scene.border]
    values = np.concatenate(parts, axis=1).astype(np.float32)
    mixed = np.einsum("nk,nkc->nc", weights, values[corners])
    points, normals, colors, sky, border = np.split(mixed, [3, 6, 9, 11], axis=1)
    is_cloth, is_inside = kind > 0, kind == 2
    towards = _unit(camera.position.astype(np.float32) - points)
    normals = _unit(-normals if is_inside else normals)
    # Cloth lets some of the light on its outside through.
    ambient = sky[:, 1:] + 0.35 * sky[:, :1] if is_inside else sky[:, :1]
    if is_inside:
        colors = _INSIDE * colors
    elif is_cloth:
        colors = colors * _hem(border, pixel)

    wrap = _CLOTH_WRAP if is_cloth else _SKIN_WRAP
    to_key, to_rim = key.direction.astype(np.float32), rim.direction.astype(np.float32)
    facing = normals @ to_key
    shadow = _lit_where(facing > -wrap.max(), key, points, normals)
    facing = facing[:, None]
    diffuse = np.clip((facing + wrap) / (1 + wrap), 0, None)
    light = _SKY * ambient + _KEY * diffuse * (shadow + (1 - shadow) * 0.15 * wrap)

    grazing = 1 - np.clip(_dot(normals, towards), 0, 1)
    edge = normals @ to_rim
    edge = np.clip(edge, 0, None)[:, None] * _lit_where(edge > 0, rim, points, normals)
    fuzz = (0.09 if is_cloth else 0.05) * grazing**3 * ambient
    shine = np.clip(_dot(normals, _unit(to_key + towards)), 0, 1)
    gloss = (0.012 * shine**8 if is_cloth else 0.05 * shine**20) * shadow * (facing > 0)
    return colors * (light + _RIM * edge) + fuzz + gloss + 0.2 * _RIM * edge * grazing**2


def _lit_where(
    faces_lamp: Bool[np.ndarray, " N"], lamp: Lamp, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N 1"]:
    """The part of the lamp that each point sees; 0 where the surface is turned away, so that it does not matter."""
    seen = np.zeros((len(points), 1), np.float32)
    seen[faces_lamp, 0] = lamp.lit(points[faces_lamp], normals[faces_lamp])
    return seen


def _hem(border: Float[np.ndarray, "N 1"], pixel: float) -> Float[np.ndarray, "N 1"]:
    """Share of the light that a hem leaves, by the distance from the border; a line thinner than a pixel is drawn
    fainter."""
    width = max(_STITCH_WIDTH, 0.6 * pixel)
    stitch = np.exp(-0.5 * ((border - _HEM_WIDTH) / width) ** 2) * _STITCH_WIDTH / width
    return 1 - _STITCH_SHADE * stitch - _HEM_SHADE * (border < _HEM_WIDTH)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nc,nc->n", a, b)[:, None]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.sqrt(_dot(vectors, vectors)), 1e-9)


def _floor_shade(scene: Scene, camera: Camera, frame: Frame, key: Lamp) -> Float[np.ndarray, "H W"]:
    """How much darker each pixel of the background is for the shadows on the floor."""
    points = scene.floor.reshape(-1, 3)
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0]), points.shape)
    shape = scene.floor.shape[:2]
    # A sharp shadow on the floor would distract from the garment: it is blurred, and fades away from the feet.
    sky = gaussian_filter(scene.floor_sky, 0.8, mode="nearest") / scene.floor_sky.max()
    direct = gaussian_filter(key.lit(points, up).reshape(shape), 2.5, mode="nearest")
    middle = scene.floor[shape[0] // 2, shape[1] // 2]
    radius = np.linalg.norm(scene.floor - middle, axis=-1)
    fade = np.clip((0.95 - radius) / 0.7, 0, 1)
    dark = fade * (0.70 * (1 - sky) + 0.20 * (1 - direct))

    # Seen from so low, the floor under the subject is a few rows of the picture.
    rows = (frame.top - camera.project(scene.floor[dark > 0])[:, 1]) / frame.pixel
    near = (rows.min() - _ROWS_MORE, rows.max() + _ROWS_MORE) if len(rows) else (0, 0)
    first, last = np.clip(np.array(near), 0, frame.height).astype(int)
    x = frame.left + (np.arange(frame.width) + 0.5) * frame.pixel
    y = frame.top - (np.arange(first, last) + 0.5) * frame.pixel
    rays = camera.rays(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    height = scene.floor[0, 0, 1] - camera.position[1]
    with np.errstate(divide="ignore"):
        along = np.where(rays[:, 1] < -1e-6, height / rays[:, 1], np.inf)
    seen = np.flatnonzero(along < 2)
    hit = camera.position + along[seen, None] * rays[seen]
    step = scene.floor[0, 1, 0] - scene.floor[0, 0, 0]
    at = (hit - scene.floor[0, 0])[:, [2, 0]].T / step
    light = np.ones((frame.height, frame.width), np.float32)
    shade = np.zeros(len(rays), np.float32)
    shade[seen] = map_coordinates(dark, at, order=1, cval=0.0)
    window = np.clip(np.minimum(x - x[0], x[-1] - x) / 0.12, 0, 1)
    light[first:last] -= shade.reshape(-1, frame.width) * window
    return light
