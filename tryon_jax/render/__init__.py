"""Pictures of dressed bodies, drawn in NumPy: no display, no GPU and no graphics driver needed."""

from tryon_jax.render.camera import VIEWS
from tryon_jax.render.colors import ColorScale
from tryon_jax.render.picture import draw, render_picture
from tryon_jax.render.sheet import SheetItem, contact_sheet

__all__ = ["VIEWS", "ColorScale", "SheetItem", "contact_sheet", "draw", "render_picture"]
