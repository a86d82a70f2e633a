"""Where a point is relative to the body: closest point on its triangles and signed distance, jittable.

The host builds a `Surface`'s topology once per body; a first face for each point is found among all. The closest
point is then followed from face to face, which is exact as long as points move by less than the local feature size
between two calls.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import cKDTree

from tryon_jax.body.normals import vertex_normals
from tryon_jax.mesh.topology import directed_edges, edge_keys
from tryon_jax.types import EXACT, ArrayLike, pytree


@pytree
class Surface:
    """A closed triangle surface in the form that closest-point queries need."""

    vertices: Float[ArrayLike, "V 3"]
    normals: Float[ArrayLike, "V 3"]
    """Outward unit normals at the vertices."""
    faces: Int[ArrayLike, "F 3"]
    adjacent_faces: Int[ArrayLike, "F 3"]
    """Face across the edge opposite to each corner."""
    vertex_faces: Int[ArrayLike, "V R"]
    """Faces around each vertex, padded with the first one."""


@pytree
class SurfacePoint:
    """Closest points on a surface."""

    position: Float[Array, "P 3"]
    normal: Float[Array, "P 3"]
    """Unit normal interpolated from the vertices."""
    distance: Float[Array, " P"]
    """Signed distance along the normal, metres; negative inside."""
    face: Int[Array, " P"]
    barycentric: Float[Array, "P 3"]


def build_surface(vertices: Float[ArrayLike, "V 3"], faces: Int[ArrayLike, "F 3"]) -> Surface:
    """Surface with its topology, on the host; move it later with `move_surface`.

    Raises:
        ValueError: the mesh is not closed (an edge without two faces).
    """
    faces = np.asarray(faces)
    num_vertices = len(vertices)
    half = directed_edges(faces)
    keys = edge_keys(half, num_vertices)
    order = np.argsort(keys, kind="stable")
    if len(keys) % 2 or (keys[order][::2] != keys[order][1::2]).any() or len(np.unique(keys)) * 2 != len(keys):
        raise ValueError("the contact surface must be closed: every edge needs exactly two faces")
    twin = np.empty(len(keys), np.int64)
    twin[order[::2]], twin[order[1::2]] = order[1::2], order[::2]
    across = (twin % len(faces)).reshape(3, -1).T
    # Half-edge k joins corners k and k + 1, so it is opposite to corner k + 2.
    adjacent = across[:, [1, 2, 0]]
    vertex_of = faces.ravel()
    by_vertex = np.argsort(vertex_of, kind="stable")
    counts = np.bincount(vertex_of, minlength=num_vertices)
    starts = np.cumsum(counts) - counts
    slot = np.minimum(np.arange(counts.max())[None, :], counts[:, None] - 1)
    ring = by_vertex[starts[:, None] + slot] // 3
    surface = Surface(
        vertices=jnp.asarray(vertices),
        normals=jnp.zeros_like(jnp.asarray(vertices)),
        faces=jnp.asarray(faces.astype(np.int32)),
        adjacent_faces=jnp.asarray(adjacent.astype(np.int32)),
        vertex_faces=jnp.asarray(ring.astype(np.int32)),
    )
    return move_surface(surface, jnp.asarray(vertices))


def move_surface(surface: Surface, vertices: Float[Array, "V 3"]) -> Surface:
    """The same surface with its vertices elsewhere (another body shape), normals recomputed."""
    normals = vertex_normals(vertices, surface.faces)
    return Surface(vertices, normals, surface.faces, surface.adjacent_faces, surface.vertex_faces)


def nearest_vertices(surface: Surface, points: Float[ArrayLike, "P 3"]) -> Int[ArrayLike, " P"]:
    """Index of the surface vertex nearest to each point: by a k-d tree on the host, or by brute force on a GPU, which
    has tried them all before the points have come to the host."""
    if jax.default_backend() == "cpu":
        return cKDTree(np.asarray(surface.vertices)).query(np.nan_to_num(points))[1].astype(np.int32)
    return _closest_vertices(jnp.asarray(surface.vertices), jnp.asarray(points))


def closest_vertices_exact(
    body_vertices: Float[Array, "B 3"], points: Float[Array, "N 3"], block: int = 256
) -> Int[Array, " N"]:
    """Index of the closest body vertex by trying all of them, `block` points at a time; jittable."""
    body_vertices, points = jax.lax.stop_gradient((body_vertices, points))
    count = points.shape[0]
    padded = jnp.pad(points, ((0, -count % block), (0, 0)))
    squared = (body_vertices**2).sum(-1)

    def nearest(some: Float[Array, "block 3"]) -> Int[Array, " block"]:
        product = jnp.matmul(some, body_vertices.T, precision=EXACT)
        return jnp.argmin(squared[None, :] - 2.0 * product, axis=1)

    return jax.lax.map(nearest, padded.reshape(-1, block, 3)).reshape(-1)[:count]


_closest_vertices = jax.jit(partial(closest_vertices_exact, block=4096))


def closest_point_on_triangle(
    p: Float[Array, "*B 3"], a: Float[Array, "*B 3"], b: Float[Array, "*B 3"], c: Float[Array, "*B 3"]
) -> Float[Array, "*B 3"]:
    """Barycentric coordinates of the point of triangle (a, b, c) closest to p."""
    ab, ac, ap = b - a, c - a, p - a
    ab2, ac2, abac = _dot(ab, ab), _dot(ac, ac), _dot(ab, ac)
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    determinant = jnp.maximum(ab2 * ac2 - abac * abac, 1e-30)
    v, w = (ac2 * d1 - abac * d2) / determinant, (ab2 * d2 - abac * d1) / determinant
    inside = (v >= 0) & (w >= 0) & (v + w <= 1)
    on_ab = jnp.clip(d1 / jnp.maximum(ab2, 1e-30), 0.0, 1.0)
    on_ac = jnp.clip(d2 / jnp.maximum(ac2, 1e-30), 0.0, 1.0)
    bc2 = ab2 + ac2 - 2 * abac
    on_bc = jnp.clip((d2 - d1 + ab2 - abac) / jnp.maximum(bc2, 1e-30), 0.0, 1.0)

    def squared(s, t):
        # |ap − s ab − t ac|² without the constant |ap|².
        return s * s * ab2 + t * t * ac2 + 2 * s * t * abac - 2 * s * d1 - 2 * t * d2

    zero = jnp.zeros_like(on_ab)
    e_ab, e_ac, e_bc = squared(on_ab, zero), squared(zero, on_ac), squared(1 - on_bc, on_bc)
    ab_best = (e_ab <= e_ac) & (e_ab <= e_bc)
    ac_best = e_ac <= e_bc
    s = jnp.where(inside, v, jnp.where(ab_best, on_ab, jnp.where(ac_best, zero, 1 - on_bc)))
    t = jnp.where(inside, w, jnp.where(ab_best, zero, jnp.where(ac_best, on_ac, on_bc)))
    return jnp.stack([1 - s - t, s, t], axis=-1)


def closest_faces(surface: Surface, points: Float[Array, "P 3"], vertex: Int[ArrayLike, " P"]) -> Int[Array, " P"]:
    """The face nearest to each point among those around a given vertex (the nearest one, from `nearest_vertices`)."""
    ring = surface.vertex_faces[vertex]
    corners = surface.vertices[surface.faces[ring]]
    p = points[:, None]
    weights = closest_point_on_triangle(
        jnp.broadcast_to(p, corners.shape[:2] + (3,)), corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]
    )
    distance = ((p - jnp.einsum("prk,prkc->prc", weights, corners, precision=EXACT)) ** 2).sum(-1)
    return jnp.take_along_axis(ring, jnp.argmin(distance, axis=1)[:, None], axis=1)[:, 0]


def follow_faces(
    surface: Surface, points: Float[Array, "P 3"], face: Int[Array, " P"], hops: int = 2
) -> Int[Array, " P"]:
    """Move each point's face to a neighbour across an edge while that is nearer, at most `hops` times.

    The neighbour tried is the one across the edge beyond which the point's projection lies farthest.
    """

    def project(at):
        corners = surface.vertices[surface.faces[at]]
        weights = closest_point_on_triangle(points, corners[:, 0], corners[:, 1], corners[:, 2])
        return weights, ((points - jnp.einsum("pk,pkc->pc", weights, corners, precision=EXACT)) ** 2).sum(-1)

    weights, distance = project(face)
    for _ in range(hops):
        # The smallest barycentric coordinate is opposite to the edge to cross.
        candidate = jnp.take_along_axis(surface.adjacent_faces[face], jnp.argmin(weights, axis=1)[:, None], axis=1)[
            :, 0
        ]
        new_weights, new_distance = project(candidate)
        nearer = new_distance < distance
        face = jnp.where(nearer, candidate, face)
        weights = jnp.where(nearer[:, None], new_weights, weights)
        distance = jnp.where(nearer, new_distance, distance)
    return face


def point_on_faces(surface: Surface, points: Float[Array, "P 3"], face: Int[Array, " P"]) -> SurfacePoint:
    """Closest point of each point on its given face, with the signed distance along the interpolated normal."""
    index = surface.faces[face]
    corners, normals = surface.vertices[index], surface.normals[index]
    weights = closest_point_on_triangle(points, corners[:, 0], corners[:, 1], corners[:, 2])
    position = jnp.einsum("pk,pkc->pc", weights, corners, precision=EXACT)
    normal = jnp.einsum("pk,pkc->pc", weights, normals, precision=EXACT)
    normal = normal / (jnp.linalg.norm(normal, axis=1, keepdims=True) + 1e-20)
    return SurfacePoint(position, normal, _dot(points - position, normal), face, weights)


def closest_points(surface: Surface, points: Float[ArrayLike, "P 3"]) -> SurfacePoint:
    """Closest points and signed distances of any points, found among all vertices and refined on the faces."""
    at = jnp.asarray(points)
    return point_on_faces(surface, at, closest_faces(surface, at, nearest_vertices(surface, points)))


def _dot(a: Float[Array, "*B 3"], b: Float[Array, "*B 3"]) -> Float[Array, "*B"]:
    return (a * b).sum(-1)
