"""Drapes of any topology seen at the vertices of the template, to compare them."""

import numpy as np
from jaxtyping import Float, Int

_PULL = 0.02
"""Weight that draws template vertices towards the vertices that lie near them, as in the data for R_mean."""


def template_projection(
    corners: Int[np.ndarray, "V 3"], weights: Float[np.ndarray, "V 3"], size: int
) -> tuple[Float[np.ndarray, "T V"], Float[np.ndarray, " T"]]:
    """The linear map from a drape's vertices to the template whose interpolation is nearest to it, and its weights.

    As R_mean's training data are made, as a matrix: drapes of any two topologies of any designs become comparable
    vertex by vertex. A template vertex that few vertices of the drape see counts less, from 1 down to 0.
    """
    interpolation = np.zeros((len(corners), size))
    np.add.at(interpolation, (np.arange(len(corners))[:, None], corners), weights)
    seen = np.maximum(interpolation.sum(axis=0), 1e-9)
    system = interpolation.T @ interpolation + _PULL * np.eye(size)
    right = interpolation.T + _PULL * interpolation.T / seen[:, None]
    return np.linalg.solve(system, right).astype(np.float32), np.minimum(seen, 1.0).astype(np.float32)
