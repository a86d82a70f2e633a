"""Where a point is relative to a surface, on the device: closest points and signed distances, jittable.

A first face for each point is found among those around the nearest vertex. The closest point is then followed from
face to face, which is exact as long as points move by less than the local feature size between two calls.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tryon_jax.body.normals import angle_weighted_normals, face_normals
from tryon_jax.contact.surface import Surface, nearest_vertices
from tryon_jax.types import EXACT, ArrayLike, pytree

# Barycentric weights below this are zero in single precision: the closest point is on an edge or a vertex.
_ZERO = 1e-6


@pytree
class SurfacePoint:
    """Closest points on a surface."""

    position: Float[Array, "P 3"]
    normal: Float[Array, "P 3"]
    """Unit normal interpolated from the vertices."""
    height: Float[Array, " P"]
    """Offset from the closest point along `normal`, metres; negative inside. Contact forces use it. Beside an edge or a
    corner it is shorter than the distance, which `signed_distances` gives."""
    face: Int[Array, " P"]
    barycentric: Float[Array, "P 3"]


def closest_point_on_triangle(
    p: Float[Array, "*B 3"], a: Float[Array, "*B 3"], b: Float[Array, "*B 3"], c: Float[Array, "*B 3"]
) -> Float[Array, "*B 3"]:
    """Barycentric coordinates of the point of triangle (a, b, c) closest to p.

    Args:
        p: Points, metres.
        a: First corner of each triangle, metres.
        b: Second corner.
        c: Third corner.

    Returns:
        Three weights, not negative, with sum 1.
    """
    return jnp.moveaxis(_weights(*(jnp.moveaxis(each, -1, 0) for each in (p, a, b, c))), 0, -1)


def _weights(
    p: Float[Array, "3 ..."], a: Float[Array, "3 ..."], b: Float[Array, "3 ..."], c: Float[Array, "3 ..."]
) -> Float[Array, "3 ..."]:
    """`closest_point_on_triangle` with components first: on a CPU this runs along vector registers."""
    ab, ac, ap = b - a, c - a, p - a
    ab2, ac2, abac = _along(ab, ab), _along(ac, ac), _along(ab, ac)
    d1, d2 = _along(ab, ap), _along(ac, ap)
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
    return jnp.stack([1 - s - t, s, t], axis=0)


def closest_faces(surface: Surface, points: Float[Array, "P 3"], vertex: Int[ArrayLike, " P"]) -> Int[Array, " P"]:
    """The face nearest to each point among those around a given vertex (the nearest one, from `nearest_vertices`).

    Args:
        surface: The body.
        points: Metres.
        vertex: The body vertex nearest to each point.
    """
    ring = surface.vertex_faces[vertex]
    corners = surface.vertices[surface.faces[ring]]
    p = points[:, None]
    weights = closest_point_on_triangle(
        jnp.broadcast_to(p, corners.shape[:2] + (3,)), corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]
    )
    distance = ((p - jnp.einsum("prk,prkc->prc", weights, corners, precision=EXACT)) ** 2).sum(-1)
    return _take(ring, jnp.argmin(distance, axis=1))


def follow_faces(
    surface: Surface, points: Float[Array, "P 3"], face: Int[Array, " P"], hops: int = 2
) -> Int[Array, " P"]:
    """Move each point's face to a neighbour across an edge while that is nearer, at most `hops` times.

    The neighbour tried is the one across the edge beyond which the point's projection lies farthest.

    Args:
        surface: The body.
        points: Metres.
        face: Where the search starts.
        hops: Faces that a point may cross.
    """

    p, vertices, faces = points.T, jnp.asarray(surface.vertices).T, jnp.asarray(surface.faces).T

    def project(at):
        a, b, c = (vertices[:, corner[at]] for corner in faces)
        weights = _weights(p, a, b, c)
        offset = p - _mix(weights, a, b, c)
        return weights, _along(offset, offset)

    weights, distance = project(face)
    for _ in range(hops):
        # The smallest barycentric coordinate is opposite to the edge to cross.
        candidate = jnp.asarray(surface.adjacent_faces)[face, jnp.argmin(weights, axis=0)]
        new_weights, new_distance = project(candidate)
        nearer = new_distance < distance
        face = jnp.where(nearer, candidate, face)
        weights = jnp.where(nearer[None], new_weights, weights)
        distance = jnp.where(nearer, new_distance, distance)
    return face


def point_on_faces(surface: Surface, points: Float[Array, "P 3"], face: Int[Array, " P"]) -> SurfacePoint:
    """Closest point of each point on its given face, with the height along the interpolated normal.

    Args:
        surface: The body.
        points: Metres.
        face: The face of each point.
    """
    index = jnp.asarray(surface.faces).T[:, face]
    (a, b, c), normals = jnp.asarray(surface.vertices).T[:, index].swapaxes(0, 1), jnp.asarray(surface.normals).T
    p = points.T
    weights = _weights(p, a, b, c)
    position = _mix(weights, a, b, c)
    normal = _mix(weights, *normals[:, index].swapaxes(0, 1))
    normal = normal / (jnp.sqrt(_along(normal, normal)) + 1e-20)[None]
    return SurfacePoint(position.T, normal.T, _along(p - position, normal), face, weights.T)


def signed_distances(surface: Surface, points: Float[Array, "P 3"], face: Int[Array, " P"]) -> Float[Array, " P"]:
    """Distance of each point from its given face, metres, negative inside; `face` is where its closest point lies.

    The definition of `contact.signed_distance`, on the device: the sign is that of the angle-weighted pseudonormal.
    Differentiable in the points and the surface.

    Args:
        surface: The body.
        points: Metres.
        face: The face on which each point's closest point lies.
    """
    corners = surface.vertices[surface.faces[face]]
    weights = closest_point_on_triangle(points, corners[:, 0], corners[:, 1], corners[:, 2])
    offset = points - jnp.einsum("pk,pkc->pc", weights, corners, precision=EXACT)
    side = jax.lax.stop_gradient(_dot(offset, _pseudonormals(surface, face, weights)))
    # Where the offset is zero its length has no gradient; a hundred picometres give it one.
    length = jnp.sqrt(_dot(offset, offset) + 1e-20)
    return jnp.where(side < 0, -length, length)


def _pseudonormals(surface: Surface, face: Int[Array, " P"], weights: Float[Array, "P 3"]) -> Float[Array, "P 3"]:
    """Of the face, of both faces of an edge, or of all faces of a vertex weighted by angle; not of unit length."""
    zero = weights < _ZERO
    own = face_normals(surface.vertices, surface.faces)
    at_edge = own[face] + own[_take(surface.adjacent_faces[face], jnp.argmin(weights, axis=1))]
    corner = _take(surface.faces[face], jnp.argmax(weights, axis=1))
    at_vertex = angle_weighted_normals(surface.vertices, surface.faces)[corner]
    count = zero.sum(axis=1)[:, None]
    return jnp.where(count == 0, own[face], jnp.where(count == 1, at_edge, at_vertex))


def closest_points(surface: Surface, points: Float[ArrayLike, "P 3"]) -> SurfacePoint:
    """Closest points of any points, found among all vertices and refined on the faces around the nearest one."""
    at = jnp.asarray(points)
    return point_on_faces(surface, at, closest_faces(surface, at, nearest_vertices(surface, points)))


def _take(rows: Int[Array, "P K"], column: Int[Array, " P"]) -> Int[Array, " P"]:
    return jnp.take_along_axis(rows, column[:, None], axis=1)[:, 0]


def _dot(a: Float[Array, "*B 3"], b: Float[Array, "*B 3"]) -> Float[Array, "*B"]:
    return (a * b).sum(-1)


def _mix(
    weights: Float[Array, "3 P"], a: Float[Array, "3 P"], b: Float[Array, "3 P"], c: Float[Array, "3 P"]
) -> Float[Array, "3 P"]:
    return weights[:1] * a + weights[1:2] * b + weights[2:] * c


def _along(a: Float[Array, "3 ..."], b: Float[Array, "3 ..."]) -> Float[Array, "..."]:
    return (a * b).sum(0)
