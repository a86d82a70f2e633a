"""Down- and upsampling matrices of one coarsening step (Ranjan et al. 2018, section 3)."""

from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tryon_jax.graph.coarsen import CoarseMesh
from tryon_jax.mesh.closest_points import MeshSearch

Pooling = Literal["average", "select"]


def down_matrix(coarse: CoarseMesh, pooling: Pooling = "average") -> sp.csr_array:
    """[m, n]: each coarse node is the mean of its cluster ("average") or the vertex it was ("select")."""
    m, n = len(coarse.kept), len(coarse.cluster)
    if pooling == "select":
        return sp.coo_array((np.ones(m), (np.arange(m), coarse.kept)), shape=(m, n)).tocsr()
    size = np.bincount(coarse.cluster, minlength=m)
    index = (coarse.cluster, np.arange(n))
    return sp.coo_array((1.0 / size[coarse.cluster], index), shape=(m, n)).tocsr()


def up_matrix(
    points: Float[np.ndarray, "n 3"],
    coarse_points: Float[np.ndarray, "m 3"],
    coarse_faces: Int[np.ndarray, "f 3"],
    cluster: Int[np.ndarray, " n"],
) -> sp.csr_array:
    """[n, m]: barycentric weights of each fine vertex's closest point on the coarse mesh; rows sum to 1.

    Where a coarse mesh has no triangle (or none near: a vertex that no triangle uses), the vertex copies its cluster.

    Args:
        points: Fine vertices, metres.
        coarse_points: Coarse vertices, metres.
        coarse_faces: Coarse triangles.
        cluster: The coarse vertex that each fine one was merged into.
    """
    n, m = len(points), len(coarse_points)
    if not len(coarse_faces):
        return sp.coo_array((np.ones(n), (np.arange(n), cluster)), shape=(n, m)).tocsr()
    found = MeshSearch(coarse_points, coarse_faces).closest(points)
    weights, columns = found.weights, coarse_faces[found.face]
    unused = np.ones(m, bool)
    unused[coarse_faces] = False
    copies = unused[cluster]
    weights[copies] = (1.0, 0.0, 0.0)
    columns[copies, 0] = cluster[copies]
    keep = weights > 1e-9
    rows = np.broadcast_to(np.arange(n)[:, None], columns.shape)
    up = sp.coo_array((weights[keep], (rows[keep], columns[keep])), shape=(n, m)).tocsr()
    up.data *= np.repeat(1.0 / up.sum(axis=1), np.diff(up.indptr))
    return up
