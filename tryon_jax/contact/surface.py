"""A closed surface prepared for closest-point queries: topology once, on the host; then moved to any body shape."""

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


def build_surface(vertices: Float[ArrayLike, "V 3"], faces: Int[ArrayLike, "F 3"]) -> Surface:
    """Prepare a surface with its topology, on the host; `move_surface` moves it later.

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
    """Index of the closest body vertex by trying all of them, `block` points at a time; jittable.

    Args:
        body_vertices: Metres.
        points: Metres.
        block: Points at a time.
    """
    body_vertices, points = jax.lax.stop_gradient((body_vertices, points))
    count = points.shape[0]
    padded = jnp.pad(points, ((0, -count % block), (0, 0)))
    squared = (body_vertices**2).sum(-1)

    def nearest(some: Float[Array, "block 3"]) -> Int[Array, " block"]:
        product = jnp.matmul(some, body_vertices.T, precision=EXACT)
        return jnp.argmin(squared[None, :] - 2.0 * product, axis=1)

    return jax.lax.map(nearest, padded.reshape(-1, block, 3)).reshape(-1)[:count]


_closest_vertices = jax.jit(partial(closest_vertices_exact, block=4096))
