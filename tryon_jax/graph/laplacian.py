"""The graph of a mesh and its scaled normalised Laplacian (Defferrard et al. 2016, section 2.1)."""

from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

# Below this the dense solver is faster than starting Lanczos, and Lanczos needs more vectors than there are.
_DENSE_BELOW = 64

Normalisation = Literal["random-walk", "symmetric"]
"""random-walk: L = I − D^{−1} A, which maps constants to zero: irregular vertices see what their neighbours see.
symmetric: L = I − D^{−1/2} A D^{−1/2}, as in Defferrard et al. Both have the same spectrum."""


def normalised_laplacian(edges: Int[np.ndarray, "E 2"], num_nodes: int) -> sp.csr_array:
    """L = I − D^{−1/2} A D^{−1/2} of an undirected graph without loops or repeated edges, float64.

    A node without an edge has an empty row, so that the null space of L has one dimension per component.
    """
    row = np.concatenate([edges[:, 0], edges[:, 1]])
    column = np.concatenate([edges[:, 1], edges[:, 0]])
    degree = np.bincount(row, minlength=num_nodes).astype(float)
    scale = np.where(degree > 0, 1.0 / np.sqrt(np.maximum(degree, 1.0)), 0.0)
    nodes = np.arange(num_nodes)
    data = np.concatenate([-scale[row] * scale[column], (degree > 0).astype(float)])
    index = (np.concatenate([row, nodes]), np.concatenate([column, nodes]))
    laplacian = sp.coo_array((data, index), shape=(num_nodes, num_nodes)).tocsr()
    laplacian.eliminate_zeros()
    return laplacian


def largest_eigenvalue(laplacian: sp.csr_array, tolerance: float = 1e-4) -> float:
    """λ_max of a normalised Laplacian, never below the true value and at most `tolerance` (relative) above it.

    Lanczos converges from below; the bound adds the residual tolerance. The start vector is fixed, so the value is
    reproducible. 2, which bounds every normalised Laplacian, is returned where the graph has no edge.
    """
    n = laplacian.shape[0]
    if laplacian.nnz == 0:
        return 2.0
    if n <= _DENSE_BELOW:
        return float(np.linalg.eigvalsh(laplacian.toarray())[-1])
    start = np.random.default_rng(0).standard_normal(n)
    # SciPy would multiply by a matrix of one column, and check it each time.
    product = LinearOperator(laplacian.shape, matvec=lambda x: laplacian @ x, dtype=laplacian.dtype)
    try:
        value = eigsh(product, k=1, which="LA", v0=start, tol=0.5 * tolerance, return_eigenvectors=False)[0]
    except ArpackNoConvergence:
        return 2.0
    return min(float(value) * (1.0 + 0.5 * tolerance), 2.0)


def scaled_laplacian(
    edges: Int[np.ndarray, "E 2"], num_nodes: int, normalisation: Normalisation = "random-walk"
) -> tuple[sp.csr_array, float]:
    """L̃ = 2 L / λ_max − I, with spectrum in [−1, 1], and λ_max (computed, not assumed).

    Args:
        edges: Pairs of nodes, without loops or repetitions.
        num_nodes: Number of nodes N.
        normalisation: See `Normalisation`.
    """
    laplacian = normalised_laplacian(edges, num_nodes)
    bound = largest_eigenvalue(laplacian)
    row, column = np.repeat(np.arange(num_nodes), np.diff(laplacian.indptr)), laplacian.indices
    values = laplacian.data
    if normalisation == "random-walk":
        root = null_vector(edges, num_nodes)
        values = (1.0 / root).take(row) * values * root.take(column)
    values = values * (2.0 / bound)
    # A node without an edge has no entry yet.
    alone = np.flatnonzero(np.diff(laplacian.indptr) == 0)
    index = (np.concatenate([row, alone]), np.concatenate([column, alone]))
    data = np.concatenate([values - (row == column), np.full(len(alone), -1.0)])
    scaled = sp.coo_array((data, index), shape=laplacian.shape).tocsr()
    scaled.eliminate_zeros()
    return scaled, bound


def null_vector(edges: Int[np.ndarray, "E 2"], num_nodes: int) -> Float[np.ndarray, " V"]:
    """D^{1/2} 1, which the symmetric L maps to zero (and L̃ to its negative); 1 at nodes without an edge."""
    degree = np.bincount(edges.ravel(), minlength=num_nodes)
    return np.sqrt(np.maximum(degree, 1.0))
