"""How much of a garment is inside a body, and how deep (host side, exact)."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from tryon_jax.body.shape import check_betas, shape_body
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.types import ArrayLike, Body

FACE_SAMPLES = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]]) / 6
"""Barycentric points of each face that must be outside the body, besides the vertices."""
EXTREMITIES = ("wrist", "hand", "ankle", "foot")
"""Joints whose skin cloth does not collide with exactly (see `physics.proxy`)."""

# Outside, distances up to this are exact, metres.
_EXACT = 0.01
_shape = jax.jit(shape_body)


@dataclass(frozen=True)
class Penetration:
    """What of a garment is inside the body."""

    vertices: float
    """Share of vertices inside, 0 to 1."""
    surface: float
    """Share of vertices and face samples inside."""
    closest: float
    """Signed distance of the innermost of them, metres: negative when one is inside."""

    @property
    def depth(self) -> float:
        """Depth of the deepest of them, metres; 0 when all are outside."""
        return max(0.0, -self.closest)


def extremity_vertices(body: Body) -> Bool[np.ndarray, " V"]:
    """True for the body's vertices of hands and feet."""
    outer = [i for i, name in enumerate(body.joint_names) if name.split("_")[-1] in EXTREMITIES]
    return np.asarray(body.lbs_weights)[:, outer].sum(axis=1) > 0.5


class Skin:
    """The skin of a body in one shape, to measure garments from.

    Hands and feet are left out: simulated cloth slides over a smooth proxy there, not over fingers and toes.
    """

    def __init__(self, body: Body, surface: ClosedSurface) -> None:
        """Prepare the skin of `body`, which is `surface` in this shape."""
        self._surface = surface
        self._left_out = extremity_vertices(body)

    @classmethod
    def of_shape(cls, body: Body, betas: Float[ArrayLike, " b"]) -> "Skin":
        """The skin of `body` with shape `betas`.

        Raises:
            ValueError: The body's mesh is not closed, or the number of betas is not its own.
        """
        vertices = np.asarray(_shape(body, check_betas(body, betas))[0])
        return cls(body, ClosedSurface(vertices, np.asarray(body.faces)))

    def signed_distances(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " P"]:
        """Distance of each point from the skin, metres, negative inside; infinite beside hands and feet.

        Exact inside and up to 1 cm outside; farther out it may be too large.
        """
        found = self._surface.closest(points, exact_below=_EXACT)
        distance, face, weights = found.distance, found.face, found.weights
        inside = np.flatnonzero(distance < -_EXACT)
        if len(inside):
            deep = self._surface.closest(np.asarray(points)[inside])
            distance[inside], face[inside], weights[inside] = deep.distance, deep.face, deep.weights
        nearest = self._surface.faces[face, np.argmax(weights, axis=1)]
        return np.where(self._left_out[nearest], np.inf, distance)

    def inside_share(self, vertices: Float[np.ndarray, "V 3"]) -> float:
        """Share of vertices inside the body, 0 to 1."""
        return float((self.signed_distances(vertices) < 0).mean())

    def penetration(self, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Penetration:
        """What of a garment is inside, by its vertices and four samples of each face."""
        corners = np.asarray(vertices, np.float64)[faces]
        samples = np.einsum("sk,fkc->fsc", FACE_SAMPLES, corners)
        at_vertices = self.signed_distances(vertices)
        # Distance grows by one metre in a metre at most, so a sample whose corner is far outside is outside too.
        to_corner = np.linalg.norm(samples[:, :, None] - corners[:, None], axis=3)
        known = np.where(np.isinf(at_vertices), -np.inf, at_vertices)
        least = (known[faces][:, None] - to_corner).max(axis=2)
        asked = samples[least < max(0.0, at_vertices.min())]
        at_samples = self.signed_distances(asked)
        inside = int((at_vertices < 0).sum()), int((at_samples < 0).sum())
        return Penetration(
            vertices=inside[0] / len(vertices),
            surface=sum(inside) / (len(vertices) + least.size),
            closest=float(min(at_vertices.min(), at_samples.min(initial=np.inf))),
        )
