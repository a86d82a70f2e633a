"""Contact of the cloth with itself: vertices keep a distance from triangles of other parts of the cloth.

Off unless asked for: T-shirts and dresses on a body in T-pose hardly ever touch themselves, and samples are counted for
self-intersections anyway. The host finds candidate pairs from time to time and remembers on which side of its
triangle each vertex was; between two searches the pairs are fixed, and a vertex that has passed through is pushed back
to where it came from. There is no friction between layers.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float, Int
from scipy.spatial import cKDTree

from tryon_jax.contact.closest_points import closest_point_on_triangle
from tryon_jax.mesh.topology import unique_edges
from tryon_jax.mesh.triangles import Triangles
from tryon_jax.physics.body_contact import ContactLaw, pressure
from tryon_jax.types import EXACT, ArrayLike, Scalar, pytree

EDGE_MARGIN = 0.5
"""How far beyond a triangle's border, in thicknesses, it still acts on a vertex, so that the corners of a fold stay
closed."""


@dataclass(frozen=True)
class SelfContact:
    """How cloth is kept from passing through itself."""

    thickness: float = 4e-3
    """Distance between layers at which contact begins, metres."""
    reach: float = 3e-2
    """Distance within which pairs are found, metres: more than vertices approach each other between two searches, at
    most `refresh` times the solver's largest move (from either side)."""
    rings: int = 2
    """Triangles up to this many edges away from a vertex belong to the same part of the cloth."""
    capacity: int = 1024
    """Pairs that fit at first; doubled when they do not."""
    refresh: int = 3
    """Steps after which pairs are searched anew."""


@pytree
class SelfPairs:
    """Vertices and the triangles that they must not pass; of a fixed capacity P."""

    vertex: Int[ArrayLike, " P"]
    triangle: Int[ArrayLike, "P 3"]
    """Vertices of the triangle."""
    side: Float[ArrayLike, " P"]
    """1 or −1: the side of the triangle that the vertex belongs to; 0 for padding."""
    thickness: Float[ArrayLike, ""]
    """Distance at which contact begins, metres."""


def find_pairs(
    x: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    settings: SelfContact,
    capacity: int,
    previous: SelfPairs | None = None,
) -> tuple[SelfPairs, bool]:
    """Pairs within reach, on the host, and whether there were more than `capacity` of them.

    Args:
        x: positions without padding, metres.
        faces: triangles without padding.
        settings: thickness, reach and what counts as the same part of the cloth.
        capacity: P; on overflow the nearest pairs are kept and the flag is set.
        previous: pairs of the last search; those found again keep their side, even if they have passed through.
    """
    points, faces = np.asarray(x, float), np.asarray(faces)
    corners = points[faces]
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    vertex_tree, centre_tree = cKDTree(points), cKDTree(centres)
    near = vertex_tree.sparse_distance_matrix(centre_tree, settings.reach + radii.max(), output_type="ndarray")
    vertex, face = near["i"], near["j"]
    keep = near["v"] < settings.reach + radii[face]
    vertex, face = vertex[keep], face[keep]
    keep = _far_apart(faces, len(points), settings.rings, vertex, face)
    vertex, face = vertex[keep], face[keep]

    a, b, c = (corners[face, k] for k in range(3))
    _, v, w = Triangles(corners).closest(points[vertex], face)
    weights = np.stack([1 - v - w, v, w], axis=1)
    offset = points[vertex] - np.einsum("pk,pkc->pc", weights, corners[face])
    distance = np.linalg.norm(offset, axis=1)
    inside = distance < settings.reach
    order = np.flatnonzero(inside)[np.argsort(distance[inside], kind="stable")]
    overflow = len(order) > capacity
    order = order[:capacity]
    vertex, face, offset = vertex[order], face[order], offset[order]
    normal = np.cross(b[order] - a[order], c[order] - a[order])
    side = np.where(np.einsum("pc,pc->p", offset, normal) < 0, -1.0, 1.0)
    triangle = faces[face]
    if previous is not None:
        side = _keep_sides(vertex, triangle, side, previous, len(points))

    padding = capacity - len(order)
    dtype = np.asarray(x).dtype
    pairs = SelfPairs(
        vertex=jnp.asarray(np.pad(vertex, (0, padding)).astype(np.int32)),
        triangle=jnp.asarray(np.pad(triangle, ((0, padding), (0, 0))).astype(np.int32)),
        side=jnp.asarray(np.pad(side, (0, padding)).astype(dtype)),
        thickness=jnp.asarray(settings.thickness, dtype),
    )
    return pairs, bool(overflow)


def self_contact(
    x: Float[Array, "V 3"], pairs: SelfPairs, vertex_areas: Float[ArrayLike, " V"], law: ContactLaw, margin: Scalar
) -> tuple[Float[Array, "V 3"], Float[Array, "V 3 3"]]:
    """Gradient (newtons) and diagonal stiffness blocks (N/m) of the contact of cloth with itself.

    Pressure follows the same hardening law as on the body. A pair couples four vertices that share no edge; their
    matrix is bounded by its diagonal (w wᵀ ≤ diag(|w| Σ|w|) for the weights w = (1, −barycentric)), so that the
    sparsity of the system stays that of the mesh.

    Args:
        x: Vertices, metres.
        pairs: Vertices and faces near each other.
        vertex_areas: Rest area of each vertex, m².
        law: Constants of contact.
        margin: The stiffness is read so much deeper, metres.
    """
    corners = x[pairs.triangle]
    point = x[pairs.vertex]
    closest = closest_point_on_triangle(point, corners[:, 0], corners[:, 1], corners[:, 2])
    offset = point - jnp.einsum("pk,pkc->pc", closest, corners, precision=EXACT)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = jnp.cross(first, second)
    squared = (normal * normal).sum(-1) + 1e-24
    # Where the vertex projects onto the triangle's plane: these weights make the force a gradient, free of torque.
    arm = point - corners[:, 0]
    u = (jnp.cross(arm, second) * normal).sum(-1) / squared
    v = (jnp.cross(first, arm) * normal).sum(-1) / squared
    weights = jnp.stack([1 - u - v, u, v], axis=-1)
    normal = normal / jnp.sqrt(squared)[:, None]
    along = (offset * normal).sum(-1)
    beyond = jnp.sqrt(jnp.maximum((offset * offset).sum(-1) - along * along, 0.0))
    felt = (pairs.side != 0) & (beyond < EDGE_MARGIN * pairs.thickness)
    approach = jnp.where(felt, pairs.thickness - pairs.side * along, 0.0)
    area = jnp.asarray(vertex_areas)[pairs.vertex]
    thickness = jnp.asarray(pairs.thickness)
    value, _ = pressure(approach, thickness, law)
    _, slope = pressure(approach + jnp.where(approach > 0, margin, 0.0), thickness, law)
    force = (area * value * pairs.side)[:, None] * normal
    size = 1 + jnp.abs(weights).sum(-1)
    block = (size * area * slope)[:, None, None] * normal[:, :, None] * normal[:, None, :]

    weights = jnp.where(felt[:, None], weights, 0.0)
    gradient = jnp.zeros_like(x).at[pairs.vertex].add(-force)
    gradient = gradient.at[pairs.triangle].add(weights[:, :, None] * force[:, None, :])
    blocks = jnp.zeros((len(x), 3, 3), x.dtype).at[pairs.vertex].add(block)
    blocks = blocks.at[pairs.triangle].add(jnp.abs(weights)[:, :, None, None] * block[:, None])
    return gradient, blocks


def _far_apart(faces: np.ndarray, num_vertices: int, rings: int, vertex: np.ndarray, face: np.ndarray) -> np.ndarray:
    """True where none of the face's vertices is within `rings` edges of the vertex."""
    edges, _ = unique_edges(faces, num_vertices)
    ones = np.ones(2 * len(edges), np.int32)
    both = (np.r_[edges[:, 0], edges[:, 1]], np.r_[edges[:, 1], edges[:, 0]])
    step = sp.csr_matrix((ones, both), (num_vertices, num_vertices)) + sp.identity(num_vertices, np.int32, format="csr")
    around = step
    for _ in range(rings - 1):
        around = around @ step
        around.data[:] = 1
    keys = np.repeat(np.arange(num_vertices), np.diff(around.indptr)) * num_vertices + around.indices
    wanted = vertex.astype(np.int64)[:, None] * num_vertices + faces[face]
    return np.asarray(~np.isin(wanted, keys).any(axis=1))


def _keep_sides(
    vertex: np.ndarray, triangle: np.ndarray, side: np.ndarray, previous: SelfPairs, num_vertices: int
) -> np.ndarray:
    old_side = np.asarray(previous.side, float)
    used = old_side != 0
    if not used.any():
        return side

    def key(v: np.ndarray, t: np.ndarray) -> np.ndarray:
        # Two corners in order name an oriented triangle of a manifold mesh.
        return (v.astype(np.int64) * num_vertices + t[:, 0]) * num_vertices + t[:, 1]

    old = key(np.asarray(previous.vertex)[used], np.asarray(previous.triangle)[used])
    order = np.argsort(old)
    old, old_side = old[order], old_side[used][order]
    wanted = key(vertex, triangle)
    at = np.minimum(np.searchsorted(old, wanted), len(old) - 1)
    return np.where(old[at] == wanted, old_side[at], side)
