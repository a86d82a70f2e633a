"""The linear solver: conjugate gradients preconditioned by the diagonal blocks, with a coarse correction beside them
where one is given."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.physics.block_matrix import BlockMatrix, invert_blocks, multiply
from tryon_jax.physics.coarse import CoarseInverse, coarse_correction


def _dot(a: Float[Array, "3 V"], b: Float[Array, "3 V"]) -> Float[Array, ""]:
    """Twice as fast on a CPU as `jnp.vdot`, which is a call."""
    return (a * b).sum()


def conjugate_gradients(
    matrix: BlockMatrix,
    neighbours: Int[Array, "S V"],
    right: Float[Array, "V 3"],
    tolerance: Float[Array, ""],
    max_iterations: Int[Array, ""],
    coarse: CoarseInverse | None = None,
    pinned: Bool[Array, " V"] | None = None,
) -> tuple[Float[Array, "V 3"], Int[Array, ""]]:
    """Solve for a symmetric positive definite matrix to a relative residual in the norm of the inverse diagonal blocks.

    Pinned rows are projected out of every residual (Baraff and Witkin 1998), which keeps them out of every direction:
    what is solved is the system of the free rows, and its condition does not suffer from the pins.

    Args:
        matrix: the matrix.
        neighbours: the row that each block beside the diagonal multiplies.
        right: right-hand side.
        tolerance: relative residual to stop at.
        max_iterations: iterations at most.
        coarse: of this matrix or one much like it, made with the same `pinned`; without it the preconditioner is the
            diagonal blocks.
        pinned: rows whose solution is zero, whatever their right-hand side.

    Returns:
        the solution and the number of iterations taken.
    """
    inverse = invert_blocks(matrix.diagonal)
    # The barrier keeps the matrix from being fused into, and recomputed in, every product.
    matrix = jax.lax.optimization_barrier(matrix)
    right = right.T

    def project(r):
        return r if pinned is None else jnp.where(pinned[None], 0.0, r)

    right = project(right)

    def blockwise(r):
        return inverse[0] * r[0][None] + inverse[1] * r[1][None] + inverse[2] * r[2][None]

    def precondition(r):
        """The preconditioned residual, its product with the residual, and that product of the diagonal blocks alone:
        solutions are as exact with a coarse correction as without."""
        z = blockwise(r)
        size = _dot(r, z)
        if coarse is None:
            return z, size, size
        z = z + coarse_correction(coarse, r)
        return z, _dot(r, z), size

    z, start, size = precondition(right)
    goal = tolerance * tolerance * size

    def running(carry):
        iteration, _, _, _, _, size = carry
        return (iteration < max_iterations) & (size > goal)

    def iterate(carry):
        iteration, y, r, p, rz, _ = carry
        product = project(multiply(matrix, neighbours, p))
        alpha = rz / _dot(p, product)
        y, r = y + alpha * p, r - alpha * product
        z, new, size = precondition(r)
        return iteration + 1, y, r, z + (new / rz) * p, new, size

    zero = jnp.zeros((), max_iterations.dtype)
    carry = (zero, jnp.zeros_like(right), right, z, start, size)
    iterations, solution, *_ = jax.lax.while_loop(running, iterate, carry)
    return solution.T, iterations
