"""Where a garment starts before it is draped: flat panels before and behind the body, closed at the seams."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tryon_jax.garment.mesh import SewnMesh

HEIGHT = 0.54
"""Height of the pattern's origin above the pelvis, metres: the overarm seam lies about 1 cm above the arms of the
embedded female body. For another body take the top of its shoulder at |x| = 0.185 m plus 0.026 m."""

DEPTH = 0.06
"""Distance of the panels from the body's plane away from the seams, metres."""

BLEND = 0.08
"""Distance from a seam over which a panel rises to its full depth, metres."""


def placement(
    mesh: SewnMesh, height: float = HEIGHT, depth: float = DEPTH, blend: float = BLEND
) -> Float[np.ndarray, "V 3"]:
    """Starting positions of a garment round a body in T-pose, like two sides of a flat pillow.

    x = u and y = v + height; front panels bulge to +z and back panels to −z by depth · (1 − (1 − min(d / blend, 1))²),
    where d is the distance in UV to the nearest seam of the panel. Seams lie in the plane z = 0.

    Args:
        mesh: The garment.
        height: Height of v = 0 above the pelvis, metres.
        depth: Distance of a panel's middle from the plane z = 0, metres.
        blend: Distance from a seam over which a panel rises to `depth`, metres.

    Returns:
        positions [V, 3], metres, pelvis at the origin.
    """
    sewn = np.concatenate([pair.ravel() for pair in mesh.seam_uv.values()])
    rise = np.zeros(len(mesh.uv))
    for k, side in enumerate(mesh.panel_sides):
        here = np.flatnonzero(mesh.uv_panels == k)
        seam = sewn[mesh.uv_panels[sewn] == k]
        distance = cKDTree(mesh.uv[seam]).query(mesh.uv[here])[0]
        profile = depth * (1.0 - (1.0 - np.minimum(distance / blend, 1.0)) ** 2)
        rise[here] = profile if side == "front" else -profile
    at = mesh.vertex_uv
    return np.stack([mesh.uv[at, 0], mesh.uv[at, 1] + height, rise[at]], axis=1)
