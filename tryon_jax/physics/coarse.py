"""The coarse half of the linear solver's preconditioner: the cloth as a few rigid patches that can only translate.

The diagonal blocks alone leave the smooth stretching of whole panels to many iterations. Galerkin's coarse matrix on
patches of neighbouring vertices, inverted once, removes it (a two-level additive Schwarz method). It is a
preconditioner: a matrix of some steps ago serves as well.
"""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.physics.block_matrix import BlockMatrix
from tryon_jax.physics.patches import Patches
from tryon_jax.types import EXACT, pytree

RIDGE = 1e-5
"""Added to the coarse diagonal, relative to it: what single precision needs to invert a loose garment's matrix."""


@pytree
class CoarseInverse:
    """Patches, and the inverse of the matrix between them."""

    patches: Patches
    inverse: Float[Array, "D D"]
    """D = 3 G: x of all patches, then y, then z. With four axes a CPU would take ten times longer for the product."""


def invert_coarse(
    blocks: BlockMatrix,
    neighbours: Int[Array, "S V"],
    patches: Patches,
    pinned: Bool[Array, " V"] | None = None,
) -> CoarseInverse:
    """Galerkin's matrix of the patches' translations, inverted.

    Args:
        blocks: The system's matrix, N/m.
        neighbours: The vertex of each block's column beside the diagonal.
        patches: Which vertices move together.
        pinned: Vertices that do not move: they leave their patches.
    """
    patch = jnp.asarray(patches.patch)
    count, one_more = len(patches.members), len(patches.members) + 1
    if pinned is not None:
        patch = jnp.where(pinned, count, patch)
        patches = replace(patches, patch=patch)
    own, pairs = patch * one_more + patch, (patch * one_more)[None] + patch[neighbours]
    matrix = jnp.zeros((one_more * one_more, 9), blocks.diagonal.dtype)
    matrix = matrix.at[own].add(blocks.diagonal.transpose(2, 0, 1).reshape(-1, 9))
    matrix = matrix.at[pairs.reshape(-1)].add(blocks.beside.transpose(0, 3, 1, 2).reshape(-1, 9))
    matrix = matrix.reshape(one_more, one_more, 3, 3)[:count, :count].transpose(2, 0, 3, 1).reshape(3 * count, -1)
    diagonal = jnp.diagonal(matrix)
    # A patch without vertices has no row of its own.
    matrix = matrix + jnp.diag(jnp.where(diagonal > 0, RIDGE * diagonal, 1.0))
    inverse = jnp.linalg.inv(matrix)
    return CoarseInverse(patches, 0.5 * (inverse + inverse.T))


def coarse_correction(coarse: CoarseInverse, residual: Float[Array, "3 V"]) -> Float[Array, "3 V"]:
    """The correction of the residual by translations of the patches."""
    members, patch = jnp.asarray(coarse.patches.members), jnp.asarray(coarse.patches.patch)
    forces = residual.at[:, members].get(mode="fill", fill_value=0).sum(-1)
    moves = jnp.matmul(coarse.inverse, forces.reshape(-1), precision=EXACT).reshape(forces.shape)
    return moves.at[:, patch].get(mode="fill", fill_value=0)
