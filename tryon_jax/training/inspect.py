"""Statistics of a simulated drape: at rest, outside the body, not through itself, not under impossible tension."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.contact.skin import Skin
from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.dressing import Drape, Obstacle
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.stretch import deformation_gradients, green_strain, principal_stretches, stress

_stretches = jax.jit(principal_stretches)


def principal_tension(x: Float[np.ndarray, "V 3"], cloth: Cloth, fabric: Fabric) -> Float[np.ndarray, " F"]:
    """Largest principal stress of each face, N/m; faces of padding have zero area, and the caller drops them.

    Args:
        x: Vertices, metres.
        cloth: Rest state.
        fabric: Material.
    """
    return np.asarray(_tension(jnp.asarray(x), cloth, fabric))


@jax.jit
def _tension(x: Float[Array, "V 3"], cloth: Cloth, fabric: Fabric) -> Float[Array, " F"]:
    s = stress(green_strain(deformation_gradients(x, cloth)), fabric)
    mean, half = 0.5 * (s[:, 0] + s[:, 1]), 0.5 * (s[:, 0] - s[:, 1])
    return mean + jnp.sqrt(half * half + s[:, 2] * s[:, 2])


class Inspector:
    """Measures drapes of one body."""

    def __init__(self, obstacle: Obstacle) -> None:
        self.obstacle = obstacle

    def penetration(self, drape: Drape, faces: Int[np.ndarray, "F 3"]) -> tuple[float, float]:
        """Depth of the deepest sample below the skin (metres, negative when all are outside) and the share inside.

        Both are NaN for a drape that is not finite.
        """
        if not np.isfinite(drape.vertices).all():
            return float("nan"), float("nan")
        body = self.obstacle.body
        surface = ClosedSurface(self.obstacle.skin(drape.betas), np.asarray(body.faces))
        found = Skin(body, surface).penetration(drape.vertices, faces)
        return -found.closest, found.surface

    def statistics(self, drape: Drape, faces: Int[np.ndarray, "F 3"], cloth: Cloth, fabric: Fabric) -> dict[str, float]:
        """The entries of `dataset.STATISTICS` for one drape.

        Args:
            drape: The drape.
            faces: Its triangles.
            cloth: Rest state.
            fabric: Material.
        """
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
