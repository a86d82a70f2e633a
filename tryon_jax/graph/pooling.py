"""Down- and upsampling matrices of one coarsening step (Ranjan et al. 2018, section 3)."""

from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tryon_jax.graph.coarsen import CoarseMesh

Pooling = Literal["average", "select"]

# Triangles examined per point: those with the nearest centroids. More found the same triangle on every mesh tried.
_CANDIDATES = 8


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
    """
    n, m = len(points), len(coarse_points)
    if not len(coarse_faces):
        return sp.coo_array((np.ones(n), (np.arange(n), cluster)), shape=(n, m)).tocsr()
    face, weights = closest_on_triangles(points, coarse_points, coarse_faces)
    columns = coarse_faces[face]
    unused = np.ones(m, bool)
    unused[coarse_faces] = False
    copies = unused[cluster]
    weights[copies] = (1.0, 0.0, 0.0)
    columns[copies, 0] = cluster[copies]
    keep = weights > 1e-9
    rows = np.broadcast_to(np.arange(n)[:, None], columns.shape)
    up = sp.coo_array((weights[keep], (rows[keep], columns[keep])), shape=(n, m)).tocsr()
    return sp.csr_array(sp.diags_array(1.0 / up.sum(axis=1)) @ up)


def closest_on_triangles(
    points: Float[np.ndarray, "n 3"], vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Triangle and barycentric weights of the closest point, among the triangles with the nearest centroids."""
    corners = vertices[faces]
    centroids = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    count = min(_CANDIDATES, len(faces))
    to_centroid, candidate = cKDTree(centroids).query(points, np.arange(1, count + 1))
    weights = np.zeros((*candidate.shape, 3))
    distance = np.full(candidate.shape, np.inf)

    def examine(point: np.ndarray, k: np.ndarray | int) -> None:
        triangle, p = corners[candidate[point, k]], points[point]
        weight = barycentric_of_closest(p, triangle[:, 0], triangle[:, 1], triangle[:, 2])
        weights[point, k] = weight
        distance[point, k] = np.linalg.norm(np.einsum("nc,nci->ni", weight, triangle) - p, axis=1)

    row = np.arange(len(points))
    examine(row, 0)
    # No point of a triangle is nearer than its centroid less its reach: most candidates need no examination.
    hopeful = to_centroid - reach[candidate] < distance[:, :1] + 1e-12
    hopeful[:, 0] = False
    examine(*np.nonzero(hopeful))
    best = np.argmin(distance, axis=1)
    return candidate[row, best], weights[row, best]


def barycentric_of_closest(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Float[np.ndarray, "... 3"]:
    """Barycentric weights of the point of triangle abc closest to p; leading axes broadcast, slivers allowed.

    The projection onto the plane where it lies inside, else the best of the three edges.
    """

    def dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.einsum("...i,...i->...", x, y)

    ab, ac, ap = b - a, c - a, p - a
    aa, bb, cross = dot(ab, ab), dot(ac, ac), dot(ab, ac)
    pa, pb = dot(ap, ab), dot(ap, ac)
    tiny = np.finfo(float).tiny
    det = aa * bb - cross * cross
    flat = det <= 1e-14 * aa * bb
    safe = np.where(flat, 1.0, det)
    v, w = (bb * pa - cross * pb) / safe, (aa * pb - cross * pa) / safe
    inside = ~flat & (v >= 0) & (w >= 0) & (v + w <= 1)
    # Edge parameters from the same dot products: ab, ac and bc = ac − ab seen from b.
    on_ab = np.clip(pa / np.maximum(aa, tiny), 0, 1)
    on_ac = np.clip(pb / np.maximum(bb, tiny), 0, 1)
    length_bc = aa + bb - 2 * cross
    on_bc = np.clip((pb - pa + aa - cross) / np.maximum(length_bc, tiny), 0, 1)
    zero = np.zeros_like(on_ab)
    options = np.stack(
        [
            np.stack([np.where(inside, v, 0.0), np.where(inside, w, 0.0)], axis=-1),
            np.stack([on_ab, zero], axis=-1),
            np.stack([zero, on_ac], axis=-1),
            np.stack([1 - on_bc, on_bc], axis=-1),
        ],
        axis=-2,
    )
    x, y = options[..., 0], options[..., 1]
    # |v ab + w ac − ap|² without the constant |ap|².
    distance = x * x * aa[..., None] + y * y * bb[..., None] + 2 * x * y * cross[..., None]
    distance = distance - 2 * (x * pa[..., None] + y * pb[..., None])
    distance[..., 0] = np.where(inside, -np.inf, np.inf)
    best = np.argmin(distance, axis=-1)[..., None]
    v, w = np.take_along_axis(x, best, -1)[..., 0], np.take_along_axis(y, best, -1)[..., 0]
    return np.stack([1 - v - w, v, w], axis=-1)
