"""Patches of a cloth for the linear solver's coarse correction: vertices that lie together in the flat pattern.

Built on the host, once per mesh.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from tryon_jax.types import ArrayLike, pytree

PATCH = 32
"""Vertices of a patch, at most, of a cloth that needs no more than `MOST_PATCHES`."""
MOST_PATCHES = 256
"""The matrix between the patches is dense, and inverted in the cube of their number."""


@pytree
class Patches:
    """G patches of a cloth of V vertices (padding included), of M vertices or fewer."""

    members: Int[ArrayLike, "G M"]
    """Vertices of each patch; V where it has fewer."""
    patch: Int[ArrayLike, " V"]
    """Patch of each vertex; G for padding."""


def make_patches(places: Float[np.ndarray, "N 2"], panels: Int[np.ndarray, " N"], padded: int) -> Patches:
    """Patches of vertices that lie together in the flat pattern; host side.

    Panel by panel, halved across the longer side again and again, into equal numbers.

    Args:
        places: flat place of each vertex, metres.
        panels: panel of each vertex.
        padded: number of vertices with padding.
    """
    size = max(PATCH, -(-padded // MOST_PATCHES))
    count = max(1, -(-padded // size))
    # Panels side by side, far enough apart for the first cuts to fall between them.
    apart = 10.0 * _extent(places).max()
    spread = places + np.stack([apart * panels, np.zeros(len(panels))], axis=1)
    parts: list[tuple[np.ndarray, int]] = [(np.arange(len(places)), count)]
    members = np.full((count, size), padded, np.int32)
    patch = np.full(padded, count, np.int32)
    done = 0
    while parts:
        vertices, pieces = parts.pop()
        if pieces == 1:
            members[done, : len(vertices)] = vertices
            patch[vertices] = done
            done += 1
            continue
        axis = int(np.argmax(_extent(spread[vertices])))
        vertices = vertices[np.argsort(spread[vertices, axis], kind="stable")]
        left = pieces // 2
        cut = round(len(vertices) * left / pieces)
        parts += [(vertices[cut:], pieces - left), (vertices[:cut], left)]
    return Patches(jnp.asarray(members), jnp.asarray(patch))


def _extent(points: np.ndarray) -> np.ndarray:
    return np.ptp(points, axis=0) if len(points) else np.zeros(2)
