"""Maps of the fit: what can colour the cloth, and in which colours."""

import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice
from tryon_jax.render.colors import ColorScale
from tryon_jax.wear.fit import Fit

MAPS = {
    "ease": ColorScale("distance from the body, cm", 0, 8),
    "tension": ColorScale("stretch of the cloth, %", -10, 10, "diverging"),
    "penetration": ColorScale("depth inside the body, mm", 0, 10),
}
"""Scales of the maps, by name."""


def map_colors(fit: Fit, name: str) -> Float[np.ndarray, "V 3"]:
    """sRGB colour in 0 to 1 of each vertex of the drape that was measured.

    Raises:
        ValueError: `name` is none of `MAPS`.
    """
    values = {
        "ease": 100 * fit.clearance,
        "tension": 100 * fit.tension,
        "penetration": 1000 * np.maximum(-fit.clearance, 0),
    }
    return MAPS[check_choice("map", name, MAPS)].colors(values[name])
