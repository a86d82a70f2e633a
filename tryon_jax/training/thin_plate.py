"""Interpolation over body shapes by a thin plate."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RBFInterpolator


def thin_plate(
    known: Float[np.ndarray, "S b"], values: Float[np.ndarray, "S K"], wanted: Float[np.ndarray, "N b"]
) -> Float[np.ndarray, "N K"] | None:
    """Values at other shapes by a thin plate (Duchon 1977) with a plane; host side.

    Args:
        known: Shapes, in half axes of what is covered.
        values: K values at each.
        wanted: Other shapes.

    Returns:
        The values; None where the known shapes determine no plate: too few, or on a line.
    """
    plane = np.column_stack([np.ones(len(known)), known])
    if len(known) <= plane.shape[1] or np.linalg.matrix_rank(plane, tol=0.1) < plane.shape[1]:
        return None
    return RBFInterpolator(known, values, kernel="thin_plate_spline", degree=1)(wanted)
