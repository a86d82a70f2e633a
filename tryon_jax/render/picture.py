"""One picture of a dressed body from several sides."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice, check_finite, check_range
from tryon_jax.files.export import CLOTH, SKIN
from tryon_jax.render.camera import Camera, view_angle
from tryon_jax.render.colors import ColorScale
from tryon_jax.render.image import check_picture_path, draw_scale, save_image, scale_height, to_image
from tryon_jax.render.scene import Scene, build_scene, srgb_value
from tryon_jax.render.shade import Frame, render_view
from tryon_jax.types import ArrayLike

Mesh = tuple[ArrayLike, ArrayLike]
"""Vertices [V, 3] in metres and faces [F, 3]."""
Paint = Float[ArrayLike, "V 3"] | Sequence[float]
"""Of the garment, sRGB in 0 to 1: one colour for each vertex, or one for all."""
BodyPaint = Float[ArrayLike, "B 3"] | Sequence[float]
"""The same of the body."""

# Metres of air around the subject.
_MARGIN = 0.09


def render_picture(
    path: str | Path,
    body: Mesh,
    garment: Mesh | None = None,
    *,
    views: Sequence[str | float] = ("front", "side", "back"),
    height: int = 900,
    body_colors: BodyPaint = SKIN.color,
    garment_colors: Paint = CLOTH.color,
    scale: ColorScale | None = None,
    crop: str = "body",
) -> None:
    """Write a picture of a body and the garment on it, in soft studio light, to a PNG, JPEG or WebP file.

    Args:
        path: image file; its suffix picks the format.
        body: vertices [V, 3] in metres (y up, +z front) and faces [F, 3].
        garment: the same, or None for the body alone. Both sides of its faces are seen, the inside darker.
        views: named views (`front`, `three-quarter`, `side`, `back`) or degrees round the body towards its left.
        height: pixels; the width follows from the views.
        body_colors: sRGB colours in 0 to 1, one or one for each vertex.
        garment_colors: the same for the garment, e.g. `ColorScale.colors` of a map of fit.
        scale: drawn as a colour bar below, when given.
        crop: what fills the picture, `body` or `garment`.

    Raises:
        ValueError: an unknown suffix, view or crop, an empty picture, or meshes that are not finite.
        ImportError: Pillow (the `pictures` extra) is not installed.
    """
    check_picture_path(path)
    check_height(height)
    # The colour bar has a band of its own: nothing of the body is behind it.
    band = 0 if scale is None else scale_height(height)
    picture = draw(
        body,
        garment,
        views=views,
        height=max(height - band, 16),
        body_colors=body_colors,
        garment_colors=garment_colors,
        crop=crop,
    )
    image = to_image(np.concatenate([picture, np.repeat(picture[-1:], band, axis=0)]))
    if scale is not None:
        draw_scale(image, scale)
    save_image(path, image)


def draw(
    body: Mesh,
    garment: Mesh | None = None,
    *,
    views: Sequence[str | float] = ("front", "side", "back"),
    height: int = 900,
    body_colors: BodyPaint = SKIN.color,
    garment_colors: Paint = CLOTH.color,
    crop: str = "body",
    focus: Float[np.ndarray, "N 3"] | None = None,
) -> Float[np.ndarray, "H W 3"]:
    """sRGB picture in 0 to 1 as an array; see `render_picture`.

    Args:
        body: Vertices in metres and triangles.
        garment: The same of the garment.
        views: Names of `camera.VIEWS`, or degrees about the vertical.
        height: Pixels.
        body_colors: One sRGB colour, or one for each vertex, 0 to 1.
        garment_colors: The same for the garment.
        crop: What fills the picture: "body" or "garment".
        focus: Points, metres, that the picture is framed by in place of those that `crop` names, so that several
            pictures can have one scale.
    """
    if not views:
        raise ValueError("views must name at least one view")
    check_height(height)
    angles = [view_angle(view) for view in views]
    scene = build_scene(
        _checked("body", body),
        None if garment is None else _checked("garment", garment),
        np.asarray(body_colors, np.float64),
        np.asarray(garment_colors, np.float64),
    )
    if focus is None:
        focus = focus_points(body, garment, crop)
    return srgb_value(_film(_views(scene, angles, focus, height)))


def check_height(height: int) -> None:
    """Raise `ValueError` for a height in pixels that no picture has."""
    check_range("picture height", height, 16, 8192, "pixels")


def focus_points(body: Mesh, garment: Mesh | None, crop: str) -> Float[np.ndarray, "N 3"]:
    """What a picture is framed by: the vertices of the body or of the garment.

    Args:
        body: Vertices in metres and triangles.
        garment: The same of the garment.
        crop: "body" or "garment".
    """
    check_choice("crop", crop, ("body", "garment"))
    if crop == "garment" and garment is not None:
        return np.asarray(garment[0], np.float64)
    return np.asarray(body[0], np.float64)


def _checked(name: str, mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = np.asarray(mesh[0]), np.asarray(mesh[1])
    check_finite(f"{name} vertices", vertices)
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError(f"{name} faces must be indices in 0 to {len(vertices) - 1}")
    return vertices, faces


def _views(scene: Scene, angles: list[float], focus: np.ndarray, height: int) -> Float[np.ndarray, "H W 3"]:
    """Linear light of all views, side by side at one scale."""
    middle = (focus.min(axis=0) + focus.max(axis=0)) / 2
    cameras = [Camera(middle, angle) for angle in angles]
    boxes = [camera.project(focus)[:, :2] for camera in cameras]
    low = min(box[:, 1].min() for box in boxes) - _MARGIN
    high = max(box[:, 1].max() for box in boxes) + _MARGIN
    pixel = (high - low) / height
    tiles = []
    for camera, box in zip(cameras, boxes, strict=True):
        left, right = box[:, 0].min() - _MARGIN, box[:, 0].max() + _MARGIN
        width = int(np.ceil((right - left) / pixel))
        frame = Frame(left=float(left), top=float(high), pixel=float(pixel), width=width, height=height)
        tiles.append(render_view(scene, camera, frame, background(height, width)))
    return np.concatenate(tiles, axis=1)


def background(height: int, width: int) -> Float[np.ndarray, "H W 3"]:
    """Linear light of a pale studio wall that runs into the floor without an edge."""
    y = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
    top, bottom = np.array([0.66, 0.68, 0.70], np.float32), np.array([0.87, 0.87, 0.865], np.float32)
    return np.broadcast_to(top + (bottom - top) * y**1.3, (height, width, 3))


def _film(linear: np.ndarray) -> np.ndarray:
    """Roll off highlights softly instead of clipping them."""
    knee = np.float32(0.75)
    over = np.maximum(linear - knee, 0)
    rolled = (1 - knee) * (1 - np.exp(over * (-1 / (1 - knee))))
    return np.minimum(linear, knee) + rolled
