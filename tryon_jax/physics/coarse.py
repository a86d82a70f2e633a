"""The coarse half of the linear solver's preconditioner: the cloth as a few stiff patches that can only move.

The diagonal blocks alone leave the smooth stretching of whole panels to many iterations. Galerkin's coarse matrix on
patches of neighbouring vertices, inverted once, takes it away (a two-level additive Schwarz method). It is a
preconditioner: a matrix of some steps ago serves as well.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tryon_jax.types import ArrayLike, pytree

PATCH = 32
"""Vertices of a patch, at most."""
RIDGE = 1e-5
"""Added to the coarse diagonal, relative to it: what single precision needs to invert a loose garment's matrix."""


@pytree
class Patches:
    """G patches of a cloth of V vertices (padding included), of `PATCH` vertices or fewer."""

    members: Int[ArrayLike, "G M"]
    """Vertices of each patch; V where it has fewer."""
    patch: Int[ArrayLike, " V"]
    """Patch of each vertex; G for padding."""


@pytree
class CoarseInverse:
    """Patches, and the inverse of the matrix between them."""

    patches: Patches
    inverse: Float[Array, "3 G 3 G"]


def make_patches(places: Float[np.ndarray, "N 2"], panels: Int[np.ndarray, " N"], padded: int) -> Patches:
    """Patches of vertices that lie together in the flat pattern; host side.

    Panel by panel, halved across the longer side again and again, into equal numbers.

    Args:
        places: flat place of each vertex, metres.
        panels: panel of each vertex.
        padded: number of vertices with padding.
    """
    count = max(1, -(-padded // PATCH))
    # Panels side by side, far enough apart for the first cuts to fall between them.
    apart = 10.0 * _extent(places).max()
    spread = places + np.stack([apart * panels, np.zeros(len(panels))], axis=1)
    parts: list[tuple[np.ndarray, int]] = [(np.arange(len(places)), count)]
    members = np.full((count, PATCH), padded, np.int32)
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


def invert_coarse(blocks: Float[Array, "V K 3 3"], neighbours: Int[Array, "V K"], patches: Patches) -> CoarseInverse:
    """Galerkin's matrix of the patches' translations, inverted."""
    patch = jnp.asarray(patches.patch)
    count, one_more = len(patches.members), len(patches.members) + 1
    pairs = patch[:, None] * one_more + patch[neighbours]
    matrix = jnp.zeros((one_more * one_more, 9), blocks.dtype).at[pairs.reshape(-1)].add(blocks.reshape(-1, 9))
    matrix = matrix.reshape(one_more, one_more, 3, 3)[:count, :count].transpose(2, 0, 3, 1).reshape(3 * count, -1)
    diagonal = jnp.diagonal(matrix)
    # A patch without vertices has no row of its own.
    matrix = matrix + jnp.diag(jnp.where(diagonal > 0, RIDGE * diagonal, 1.0))
    inverse = jnp.linalg.inv(matrix)
    return CoarseInverse(patches, (0.5 * (inverse + inverse.T)).reshape(3, count, 3, count))


def coarse_correction(coarse: CoarseInverse, residual: Float[Array, "3 V"]) -> Float[Array, "3 V"]:
    """What the patches, moved as wholes, would take from the residual."""
    inverse = coarse.inverse
    count = inverse.shape[1]
    members, patch = jnp.asarray(coarse.patches.members), jnp.asarray(coarse.patches.patch)
    forces = residual.at[:, members].get(mode="fill", fill_value=0).sum(-1)
    moves = (inverse.reshape(3 * count, 3 * count) @ forces.reshape(-1)).reshape(3, count)
    return moves.at[:, patch].get(mode="fill", fill_value=0)
