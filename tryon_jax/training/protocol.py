"""Which body shapes are simulated, in which order, and which of them may be trained on.

Shapes lie on straight rays from the mean body outwards (friction makes a drape depend on its path). Training and test
shapes interleave along each ray and between neighbouring rays, as the paper interleaves its 201 shapes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

RAY_LENGTH = 8
"""Shapes on a ray of the two-beta protocol."""
RAYS = 25
"""Rays of the two-beta protocol: 1 + 25 · 8 = 201 shapes."""
EXTENT = (3.0, 2.0)
"""Half axes of the ellipse of betas: stature and build."""
SINGLE_SHAPES = 100
"""Shapes on each of the two rays of the single-beta protocol: 1 + 2 · 100 = 201 over [−3, 3]."""


@dataclass(frozen=True, eq=False)
class Protocol:
    """Rays of betas; the mean body (all zero) comes before every ray and belongs to training."""

    rays: tuple[Float[np.ndarray, "N B"], ...]
    test: tuple[Bool[np.ndarray, " N"], ...]
    """True for shapes that are only for testing."""
    order: tuple[int, ...]
    """Order in which rays are simulated: any beginning of it covers all directions evenly."""

    @property
    def num_betas(self) -> int:
        """Number of betas B that vary."""
        return self.rays[0].shape[1]


def make_protocol(num_betas: int = 2) -> Protocol:
    """The protocol for one beta (the paper's) or two.

    Raises:
        ValueError: another number of betas.
    """
    if num_betas == 1:
        steps = np.arange(1, SINGLE_SHAPES + 1)
        rays = tuple(sign * EXTENT[0] * (steps / SINGLE_SHAPES)[:, None] for sign in (1.0, -1.0))
        return Protocol(rays, (steps % 2 == 1, steps % 2 == 1), (0, 1))
    if num_betas != 2:
        raise ValueError(f"num_betas = {num_betas} has no protocol; known: 1, 2")
    radius = np.arange(1, RAY_LENGTH + 1) / RAY_LENGTH
    angles = 2 * np.pi * np.arange(RAYS) / RAYS
    rays = tuple(radius[:, None] * np.array([EXTENT[0] * np.cos(a), EXTENT[1] * np.sin(a)])[None] for a in angles)
    test = tuple((k + np.arange(1, RAY_LENGTH + 1)) % 2 == 0 for k in range(RAYS))
    # From coarse to fine, each halfway in the widest gap. Even and odd rays alternate, since training has the outermost
    # shape of odd rays only.
    order = (0, 13, 7, 19, 4, 22, 16, 10, 2, 23, 21, 17, 15, 12, 9, 6, 24, 20, 18, 14, 11, 8, 5, 3, 1)
    return Protocol(rays, test, order)
