"""How much of a garment is inside the body, and how deep, by signed distance from the skin."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import cKDTree

from tryon_jax.body.shape import check_betas, shape_body
from tryon_jax.contact.closest_points import closest_faces, point_on_faces
from tryon_jax.contact.surface import Surface, build_surface, move_surface
from tryon_jax.types import ArrayLike, Body

FACE_SAMPLES = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]]) / 6
"""Barycentric points of each face that must be outside the body, besides the vertices."""
EXTREMITIES = ("wrist", "hand", "ankle", "foot")
"""Joints whose skin cloth does not collide with exactly (see `physics.proxy`)."""

# Points go through in parts of this size, so that one size is compiled.
_CHUNK = 4096


@dataclass(frozen=True)
class Penetration:
    """What of a garment is inside the body."""

    vertices: float
    """Share of vertices inside, 0 to 1."""
    surface: float
    """Share of vertices and face samples inside."""
    depth: float
    """Depth of the deepest of them, metres; 0 when all are outside."""


def extremity_vertices(body: Body) -> Bool[np.ndarray, " V"]:
    """True for the body's vertices of hands and feet."""
    outer = [i for i, name in enumerate(body.joint_names) if name.split("_")[-1] in EXTREMITIES]
    return np.asarray(body.lbs_weights)[:, outer].sum(axis=1) > 0.5


class Skin:
    """The body as a surface to measure from; made once, moved to any shape.

    Hands and feet are left out: simulated cloth slides over a smooth proxy there, not over fingers and toes.
    """

    def __init__(self, body: Body) -> None:
        """Raises `ValueError` when the body's mesh is not closed."""
        self.body = body
        self._surface = build_surface(np.asarray(body.v_template), np.asarray(body.faces))
        self._left_out = extremity_vertices(body)

    def at(self, betas: ArrayLike) -> "ShapedSkin":
        """The skin of one body shape."""
        surface = _move(self._surface, shape_body(self.body, check_betas(self.body, betas))[0])
        return ShapedSkin(surface, self._left_out)


class ShapedSkin:
    """The skin of one body shape."""

    def __init__(self, surface: Surface, left_out: np.ndarray) -> None:
        self._surface, self._left_out = surface, left_out
        self._tree = cKDTree(np.asarray(surface.vertices))

    def signed_distances(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " P"]:
        """Distance of each point from the skin, metres, negative inside; infinite beside hands and feet."""
        nearest = self._tree.query(points)[1].astype(np.int32)
        size = -(-len(points) // _CHUNK) * _CHUNK
        padded, start = np.zeros((size, 3), np.float32), np.zeros(size, np.int32)
        padded[: len(points)], start[: len(points)] = points, nearest
        parts = [
            np.asarray(_signed(self._surface, jnp.asarray(padded[k : k + _CHUNK]), jnp.asarray(start[k : k + _CHUNK])))
            for k in range(0, size, _CHUNK)
        ]
        distance = np.concatenate(parts)[: len(points)] if parts else np.zeros(0, np.float32)
        distance[self._left_out[nearest]] = np.inf
        return distance

    def inside_share(self, vertices: Float[np.ndarray, "V 3"]) -> float:
        """Share of vertices inside the body, 0 to 1."""
        return float((self.signed_distances(vertices) < 0).mean())

    def penetration(self, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Penetration:
        """Vertices and face samples of a garment that are inside the body."""
        samples = np.einsum("sk,fkc->fsc", FACE_SAMPLES, vertices[faces]).reshape(-1, 3)
        at_vertices, at_samples = self.signed_distances(vertices), self.signed_distances(samples)
        every = np.concatenate([at_vertices, at_samples])
        return Penetration(
            float((at_vertices < 0).mean()), float((every < 0).mean()), float(max(0.0, -every.min(initial=0.0)))
        )


_move = jax.jit(move_surface)


@jax.jit
def _signed(surface: Surface, points: Float[Array, "P 3"], vertex: Int[Array, " P"]) -> Float[Array, " P"]:
    on = point_on_faces(surface, points, closest_faces(surface, points, vertex))
    # Along the interpolated normal the distance is a little short where the closest point is on an edge.
    length = jnp.sqrt(((points - on.position) ** 2).sum(-1))
    return jnp.where(on.distance < 0, -length, length)
