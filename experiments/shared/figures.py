"""Dressed bodies in the figures of experiments, with the look that users' pictures have."""

import numpy as np
from jaxtyping import Float

from tryon_jax.files.export import CLOTH
from tryon_jax.render import SheetItem
from tryon_jax.render.mannequin import mannequin_colors
from tryon_jax.render.picture import Mesh, Paint
from tryon_jax.types import Body


def dressed_cell(
    body: Body, vertices: Float[np.ndarray, "B 3"], garment: Mesh, title: str, color: Paint = CLOTH.color
) -> SheetItem:
    """One cell of a contact sheet: a mannequin in a garment.

    Args:
        body: The body.
        vertices: Of it in its shape, metres.
        garment: Vertices and faces of the cloth.
        title: Below the picture.
        color: Of the cloth.
    """
    return SheetItem((vertices, np.asarray(body.faces)), garment, title, color, mannequin_colors(body))
