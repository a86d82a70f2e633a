"""The template's drape on the mean body, from which R_mean learns, found from the drape of a garment."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

TEMPLATE_PULL = 0.02
"""Weight of the pull in `fit_template`, in garment vertices."""


def fit_template(
    corners: Int[np.ndarray, "V 3"], weights: Float[np.ndarray, "V 3"], vertices: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "T 3"]:
    """The template whose interpolation W T̄ is nearest to a drape, in least squares.

    A weak pull towards local averages settles template vertices that few garment vertices see.

    Args:
        corners: Template vertices that each garment vertex lies between.
        weights: Its barycentric weights.
        vertices: The drape, metres.

    Returns:
        Template positions, metres.
    """
    size = int(corners.max()) + 1
    rows = np.repeat(np.arange(len(corners)), 3)
    interpolation = sp.csr_array((weights.ravel(), (rows, corners.ravel())), shape=(len(corners), size))
    seen = np.maximum(np.asarray(interpolation.sum(axis=0)), 1e-9)
    local = (interpolation.T @ vertices) / seen[:, None]
    system = (interpolation.T @ interpolation).toarray() + TEMPLATE_PULL * np.eye(size)
    return np.linalg.solve(system, interpolation.T @ vertices + TEMPLATE_PULL * local)
