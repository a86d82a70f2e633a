"""The look of a shop's mannequin: pale matt skin with light underwear drawn on it, for pictures to be shown."""

from functools import cache

import numpy as np
from jaxtyping import Float

from tryon_jax.body.embedded import NUM_VERTICES, load_body, read_asset
from tryon_jax.types import Body

SKIN = (0.80, 0.735, 0.685)
"""sRGB in 0 to 1."""
UNDERWEAR = (0.80, 0.81, 0.83)
_SOFT = 0.025
"""Metres over which one colour becomes the other: less than the distance of vertices would show their triangles."""
# Height of the front of the chest above the pelvis, metres.
_CHEST_HEIGHT = {"female": 0.30, "neutral": 0.30}
_HIPS, _CHEST, _ARMS = (0, 1, 2), (6, 9), (13, 14, 16, 17)


def mannequin_colors(body: Body) -> Float[np.ndarray, "V 3"] | tuple[float, float, float]:
    """sRGB colours of a body: one for each vertex of an embedded one, one for all of another.

    Args:
        body: In any shape; embedded bodies are known by their number of vertices.
    """
    if len(body.v_template) != NUM_VERTICES:
        return SKIN
    share = underwear(body.name if body.name in ("male", "neutral") else "female")[:, None]
    return (1 - share) * np.array([SKIN]) + share * np.array([UNDERWEAR])


@cache
def underwear(name: str) -> Float[np.ndarray, " V"]:
    """How much of each vertex of an embedded body is under briefs, or a band round the chest but on the male body."""
    weights = np.asarray(read_asset("topology", ["lbs_weights"])["lbs_weights"])
    x, y, _ = np.asarray(load_body(name).v_template).T
    # Distances inside each border, metres; the pelvis is at the origin, and legs are cut higher at the sides.
    hips = 0.2 * (weights[:, _HIPS].sum(axis=1) - 0.5)
    inside = np.minimum.reduce([0.03 - y, y + 0.215 - 0.85 * np.abs(x), hips])
    if name != "male":
        chest = 0.2 * (weights[:, _CHEST].sum(axis=1) - weights[:, _ARMS].sum(axis=1) + 0.2)
        band = np.minimum.reduce([0.075 - np.abs(y - _CHEST_HEIGHT[name]), chest, 0.165 - np.abs(x)])
        inside = np.maximum(inside, band)
    return np.clip(0.5 + inside / _SOFT, 0.0, 1.0)
