"""Many dressed bodies in one picture, all at one scale, each with its title."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tryon_jax.files.export import CLOTH, SKIN
from tryon_jax.render.colors import ColorScale
from tryon_jax.render.image import check_picture_path, draw_scale, save_image, to_image, write_words
from tryon_jax.render.picture import BodyPaint, Mesh, Paint, background, draw, focus_points
from tryon_jax.render.scene import srgb_value


@dataclass(frozen=True)
class SheetItem:
    """One cell of a contact sheet."""

    body: Mesh
    garment: Mesh | None = None
    title: str = ""
    garment_colors: Paint = CLOTH.color
    body_colors: BodyPaint = SKIN.color


def contact_sheet(
    path: str | Path,
    items: Sequence[SheetItem],
    *,
    columns: int | None = None,
    views: Sequence[str | float] = ("front",),
    height: int = 420,
    crop: str = "body",
    scale: ColorScale | None = None,
) -> None:
    """Write a grid of pictures to an image file, row by row, at one scale so that sizes can be compared.

    Args:
        path: image file; its suffix picks the format.
        items: what is in each cell; titles stand below the pictures.
        columns: cells in a row; by default about twice as many as rows.
        views: of each cell, see `render_picture`.
        height: pixels of one cell's picture.
        crop: what fills a cell, `body` or `garment`.
        scale: drawn as a colour bar below the last row, when given.

    Raises:
        ValueError: no item, or as `render_picture` raises.
        ImportError: Pillow (the `pictures` extra) is not installed.
    """
    check_picture_path(path)
    if not items:
        raise ValueError("a contact sheet needs at least one item")
    columns = columns or max(1, round((2 * len(items)) ** 0.5))
    focus = np.concatenate([focus_points(item.body, item.garment, crop) for item in items])
    pictures = [
        draw(
            item.body,
            item.garment,
            views=views,
            height=height,
            body_colors=item.body_colors,
            garment_colors=item.garment_colors,
            focus=focus,
        )
        for item in items
    ]
    words = 30 if any(item.title for item in items) else 0
    width = pictures[0].shape[1]
    rows = -(-len(items) // columns)
    foot = 70 if scale is not None else 0
    cell = height + words
    paper = srgb_value(background(2, 1)[1:])
    sheet = to_image(np.broadcast_to(paper, (rows * cell + foot, min(columns, len(items)) * width, 3)))
    for number, (item, picture) in enumerate(zip(items, pictures, strict=True)):
        row, column = divmod(number, columns)
        sheet.paste(to_image(picture), (column * width, row * cell))
        write_words(sheet, item.title, ((column + 0.5) * width, row * cell + height + words / 2), 15)
    if scale is not None:
        draw_scale(sheet, scale)
    save_image(path, sheet)
