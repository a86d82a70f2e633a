"""Statistics of a simulated drape: at rest, outside the body, not through itself, not under impossible tension."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tryon_jax.contact.closest_points import closest_faces, point_on_faces
from tryon_jax.contact.skin import FACE_SAMPLES, extremity_vertices
from tryon_jax.contact.surface import Surface, build_surface, move_surface, nearest_vertices
from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.dressing import Drape, Obstacle
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.stretch import deformation_gradients, green_strain, principal_stretches, stress

_stretches = jax.jit(principal_stretches)
_move = jax.jit(move_surface)
_signed = jax.jit(lambda surface, p, vertex: point_on_faces(surface, p, closest_faces(surface, p, vertex)))


def principal_tension(x: Float[np.ndarray, "V 3"], cloth: Cloth, fabric: Fabric) -> Float[np.ndarray, " F"]:
    """Largest principal stress of each face, N/m; padding gives zero area and is the caller's to drop."""
    return np.asarray(_tension(jnp.asarray(x), cloth, fabric))


@jax.jit
def _tension(x: Float[Array, "V 3"], cloth: Cloth, fabric: Fabric) -> Float[Array, " F"]:
    s = stress(green_strain(deformation_gradients(x, cloth)), fabric)
    mean, half = 0.5 * (s[:, 0] + s[:, 1]), 0.5 * (s[:, 0] - s[:, 1])
    return mean + jnp.sqrt(half * half + s[:, 2] * s[:, 2])


class Inspector:
    """Measures drapes of one body; holds the skin's topology."""

    def __init__(self, obstacle: Obstacle) -> None:
        self.obstacle = obstacle
        body = obstacle.body
        self._surface: Surface = build_surface(np.asarray(body.v_template), np.asarray(body.faces))
        self._extremity = extremity_vertices(body)

    def penetration(self, drape: Drape, faces: Int[np.ndarray, "F 3"]) -> tuple[float, float]:
        """Depth of the deepest sample below the skin (metres, negative when all are outside) and the share inside."""
        skin = self.obstacle.skin(drape.betas)
        surface = _move(self._surface, jnp.asarray(skin))
        x = drape.vertices
        points = np.concatenate([x, np.einsum("sk,fkc->fsc", FACE_SAMPLES, x[faces]).reshape(-1, 3)])
        points = points.astype(np.float32)
        vertex = nearest_vertices(surface, points)
        distance = np.asarray(_signed(surface, points, vertex).distance)
        distance = distance[~self._extremity[vertex]]
        return float(-distance.min()), float((distance < 0).mean())

    def statistics(self, drape: Drape, faces: Int[np.ndarray, "F 3"], cloth: Cloth, fabric: Fabric) -> dict[str, float]:
        """The entries of `dataset.STATISTICS` for one drape."""
        depth, inside = self.penetration(drape, faces)
        count = len(faces)
        tension = principal_tension(np.asarray(drape.state.x), cloth, fabric)[:count]
        stretch = np.asarray(_stretches(drape.state.x, cloth))[:count, 0]
        return {
            "residual": float(drape.report.residual),
            "steps": float(drape.report.steps),
            "depth": depth,
            "inside": inside,
            "self_intersections": float(self_intersecting_faces(drape.vertices, faces).mean()),
            "tension": float(np.percentile(tension, 95)),
            "stretch": float(np.percentile(stretch, 99)),
        }
