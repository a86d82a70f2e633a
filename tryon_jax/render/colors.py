"""Colours of measured quantities on a surface, and the scale that says what they mean."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tryon_jax.types import ArrayLike

# Ends and stops of two perceptually ordered maps, sRGB: dark blue to yellow, and blue over white to red.
_STOPS = {
    "sequential": [(0.17, 0.12, 0.42), (0.15, 0.36, 0.56), (0.12, 0.58, 0.55), (0.46, 0.79, 0.38), (0.98, 0.91, 0.33)],
    "diverging": [(0.13, 0.30, 0.65), (0.52, 0.70, 0.88), (0.95, 0.95, 0.94), (0.95, 0.62, 0.48), (0.70, 0.09, 0.17)],
}


@dataclass(frozen=True)
class ColorScale:
    """Maps values to colours, linearly from `low` to `high`; values beyond get the ends' colours."""

    label: str
    """What is shown, with its unit, e.g. "ease, cm"."""
    low: float
    high: float
    kind: str = "sequential"
    """`sequential`, or `diverging` with white in the middle."""

    def colors(self, values: Float[ArrayLike, " N"]) -> Float[np.ndarray, "N 3"]:
        """sRGB colour in 0 to 1 of each value."""
        stops = np.array(_STOPS[self.kind])
        at = (np.asarray(values, np.float64) - self.low) / (self.high - self.low)
        ticks = np.linspace(0, 1, len(stops))
        return np.stack([np.interp(at, ticks, stops[:, k]) for k in range(3)], axis=1)
