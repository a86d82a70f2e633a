"""Lowering the arms under a garment: the drape is followed from the T-pose down, the cloth in contact with itself."""

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from tryon_jax.body.pose import skinning_motion
from tryon_jax.body.stance import arms_pose
from tryon_jax.contact.surface import Surface
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, closing, relax, self_pairs
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.proxy import skinning_weights
from tryon_jax.physics.self_contact import SelfContact
from tryon_jax.physics.state import SolverSettings

STEP = 7.5
"""Degrees between two stances of a descent."""
SMALLEST_STEP = STEP / 4
"""Cloth that finds no rest, because it is caught in itself, tries again with half the step, down to this."""
_motion = jax.jit(skinning_motion)


class StanceObstacle(Obstacle):
    """The collision surface of one body shape in any stance: its betas have one entry more, the angle of the arms.

    Hands are made into mittens in T-pose, where they point along an axis, and skinned with the arm.
    """

    def __init__(self, obstacle: Obstacle, betas: Float[np.ndarray, " b"]) -> None:
        """Take over the surface of another obstacle.

        Args:
            obstacle: Of the body.
            betas: The body's shape, standard deviations.
        """
        self.body, self.collision = obstacle.body, obstacle.collision
        self._surface = obstacle.surface(betas)
        self._betas = np.asarray(betas, np.float32)
        self._still = np.asarray(self._surface.vertices)
        self._weights = skinning_weights(self.collision, np.asarray(self.body.lbs_weights))

    def at(self, degrees: float) -> Float[np.ndarray, " b"]:
        """The betas that `surface` takes for arms `degrees` below the horizontal: the body's, then the angle."""
        return np.append(np.asarray(self._betas, np.float64), degrees)

    def surface(self, betas: Float[np.ndarray, " b"]) -> Surface:
        """Collision surface of the body in the stance of `at`."""
        return self.moved(self._surface, self.carry(self._still, self._weights, 0.0, float(betas[-1])))

    def carry(
        self, points: Float[np.ndarray, "N 3"], weights: Float[np.ndarray, "N J"], before: float, after: float
    ) -> Float[np.ndarray, "N 3"]:
        """Points that are skinned from one stance to another, metres.

        Args:
            points: In the first stance, metres.
            weights: Their skinning weights.
            before: Angle of the arms, degrees.
            after: The same in the other stance.
        """
        (linear, shift), (to_linear, to_shift) = self._at(weights, before), self._at(weights, after)
        resting = np.linalg.solve(linear, (points - shift)[..., None])[..., 0]
        return np.einsum("nab,nb->na", to_linear, resting) + to_shift

    def _at(self, weights: Float[np.ndarray, "N J"], degrees: float) -> tuple[np.ndarray, np.ndarray]:
        pose = arms_pose(self.body, degrees).astype(np.float32)
        linear, shift = _motion(self.body, self._betas, pose, weights.astype(np.float32))
        return np.asarray(linear, np.float64), np.asarray(shift, np.float64)


@dataclass(frozen=True)
class Stance:
    """One drape of a descent."""

    degrees: float
    """Of the arms below the horizontal."""
    drape: Drape


def lower_arms(
    drape: Drape,
    weights: Float[np.ndarray, "V J"],
    degrees: float,
    cloth: Cloth,
    fabric: Fabric,
    obstacle: StanceObstacle,
    settings: SolverSettings,
    equilibrium: Equilibrium,
    self_contact: SelfContact | None = None,
) -> Iterator[Stance]:
    """Drapes from the T-pose to a stance, `STEP` degrees or less apart: skinned along with the arms, then at rest.

    After the smallest steps a drape is taken as it is: its report tells whether it is at rest.

    Args:
        drape: At rest in T-pose.
        weights: Skinning weights of its vertices; rows sum to 1.
        degrees: Of the arms in the last stance.
        cloth: Rest state.
        fabric: Material.
        obstacle: The body.
        settings: Of the solver.
        equilibrium: When a drape counts as at rest; its steps are those of one stance.
        self_contact: Contact of sleeves, trunk and folds with each other; the default settings when None.

    Raises:
        Diverged: Positions or forces became infinite.
    """
    contact = self_contact or SelfContact()
    before, step = 0.0, STEP
    while before < degrees:
        after = min(before + step, degrees)
        # Skinning may move one part of the cloth through another: sides are those of the drape before.
        pairs = self_pairs(drape, cloth, contact)
        start = obstacle.carry(drape.vertices.astype(np.float64), weights, before, after)
        slip = np.asarray(drape.state.slip)[: drape.num_vertices]
        found = relax(
            start,
            slip,
            obstacle.at(after),
            cloth,
            fabric,
            obstacle,
            closing(settings),
            equilibrium,
            equilibrium.max_steps,
            contact,
            pairs,
        )
        if not found.converged(equilibrium) and after - before > SMALLEST_STEP:
            step = 0.5 * (after - before)
            continue
        before, drape = after, found
        yield Stance(before, drape)
