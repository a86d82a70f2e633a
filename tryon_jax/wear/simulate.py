"""Drapes by the simulator: a garment settled on a body, dressed from its panels, or a learned drape brought to rest.

Host side, around `tryon_jax.physics`. Everything runs in pieces of some steps, after each of which progress is reported
and Ctrl-C is obeyed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from tryon_jax.checks import check_finite, check_range
from tryon_jax.metrics.strain import edge_strain
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, closing, dress, follow, start_state
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.solver import StepReport
from tryon_jax.physics.stance import StanceObstacle, lower_arms
from tryon_jax.physics.state import SolverSettings
from tryon_jax.types import Body

PIECE = 20
"""Steps between two looks at the progress."""
DRESSING_STEPS = 400
"""Steps at most for a garment put on anew, or a drape brought to rest."""
STANCE_STEPS = 200
"""Steps at most for each stance on the way of the arms."""
SHAPES = 6
"""Body shapes on the straight way from the mean body to the one that is asked for."""
SHAPE_STEPS = 60
"""Steps at most for each of those but the last."""
TORN = 2.0
"""A settled edge of more than this many times its rest length is torn: the fabrics bear about 1.25."""
NEARLY = 5.0
"""A drape whose residual is at most this many times the tolerance looks at rest: it is reported, and not refused."""

Progress = Callable[[int, float, np.ndarray], None]
"""Told the steps done, the residual and the vertices (metres) after each piece; what it raises ends the simulation."""
StanceProgress = Callable[[float, float, np.ndarray], None]
"""Told the angle of the arms (degrees), the residual and the vertices (metres) of each stance."""


class NotSettled(ValueError):
    """The simulator could not bring a garment to rest on the body, or it tore there."""


@dataclass(frozen=True, eq=False)
class Pattern:
    """A garment's mesh with its rest shape in the plane."""

    faces: Int[np.ndarray, "F 3"]
    uv: Float[np.ndarray, "U 2"]
    """Metres."""
    faces_uv: Int[np.ndarray, "F 3"]


@dataclass(frozen=True, eq=False)
class Simulated:
    """Where the simulator brought a garment."""

    vertices: Float[np.ndarray, "V 3"]
    """Metres."""
    residual: float
    """Net force over weight plus contact load."""
    tolerance: float
    """Of the residual, below which it is at rest."""
    steps: int
    moved: Float[np.ndarray, " V"]
    """Distance of each vertex from where it started, metres."""

    @property
    def at_rest(self) -> bool:
        """Whether the net force is within the tolerance."""
        return self.residual <= self.tolerance

    def words(self) -> str:
        """One sentence of what was done."""
        rest = "at rest" if self.at_rest else "not quite at rest"
        return (
            f"{self.steps} steps, {rest} (residual {self.residual:.3f}, at most {self.tolerance:g}); moved "
            f"{1e3 * self.moved.mean():.1f} mm on average, {1e3 * self.moved.max():.1f} mm at most"
        )


class Simulator:
    """The solver for one body; its compiled steps serve every garment of a size."""

    def __init__(
        self, body: Body, settings: SolverSettings | None = None, equilibrium: Equilibrium | None = None
    ) -> None:
        """Prepare the body; nothing is compiled yet.

        Args:
            body: The body.
            settings: Of the solver; defaults when None.
            equilibrium: When a drape counts as at rest; defaults when None.
        """
        self.obstacle = Obstacle(body)
        self.settings = settings or SolverSettings()
        self.equilibrium = equilibrium or Equilibrium()

    def refine(
        self,
        vertices: Float[np.ndarray, "V 3"],
        pattern: Pattern,
        fabric: Fabric,
        betas: Float[np.ndarray, " b"],
        steps: int | None = None,
        progress: Progress | None = None,
    ) -> Simulated:
        """Implicit steps from a drape, such as a learned one.

        Args:
            vertices: the drape, metres.
            pattern: its mesh and rest shape.
            fabric: what it is made of.
            betas: shape of the body.
            steps: this many at most; None to rest, at most `DRESSING_STEPS`.
            progress: told after each piece.

        Raises:
            ValueError: steps outside 1 to 10,000, vertices that are not finite, or a rest shape that is none.
            Diverged: the simulation diverged: positions or forces became infinite.
        """
        most = DRESSING_STEPS if steps is None else int(check_range("refine", steps, 1, 10_000, "steps"))
        cloth = _cloth(pattern, len(vertices))
        drape = self._laid(vertices, cloth, betas)
        # Patches of the coarse correction are made for panels: triangles that each lie by themselves have none.
        drape = self._run(drape, cloth, fabric, closing(self.settings), most, progress, 0)
        return self._result(vertices, drape)

    def settle(
        self,
        vertices: Float[np.ndarray, "V 3"],
        pattern: Pattern,
        fabric: Fabric,
        progress: Progress | None = None,
    ) -> Simulated:
        """A garment that lies roughly on the mean body, dressed there: pushed out of the body, then hung to rest.

        Args:
            vertices: The garment on the mean body, metres.
            pattern: Mesh and rest shape.
            fabric: Material.
            progress: Told while it runs.

        Raises:
            NotSettled: it tears, or is far from rest when its steps are used up.
            Diverged: the simulation diverged: positions or forces became infinite.
        """
        cloth = _cloth(pattern, len(vertices))
        drape = self._dressed(vertices, cloth, fabric, progress)
        result = self._result(vertices, drape)
        worst, where = _worst_edge(result.vertices, pattern)
        if worst > TORN:
            x, y, z = where
            raise NotSettled(
                f"the simulator tears this garment on the body: an edge is {worst:.1f} times its length near "
                f"({x:.2f}, {y:.2f}, {z:.2f}) m. It may be too small, or lie elsewhere: check unit, offset and pose"
            )
        if result.residual > NEARLY * result.tolerance:
            raise NotSettled(
                f"the garment does not come to rest on the body in {result.steps} steps (residual "
                f"{result.residual:.3f}, at rest below {result.tolerance:g}): it may be falling off, or be no cloth"
            )
        return result

    def dress(
        self,
        panels: Float[np.ndarray, "V 3"],
        pattern: Pattern,
        fabric: Fabric,
        betas: Float[np.ndarray, " b"],
        progress: Progress | None = None,
    ) -> Simulated:
        """A garment dressed on the mean body from where it is laid, and carried to a body of shape `betas`.

        Args:
            panels: Where the garment is laid, metres.
            pattern: Mesh and rest shape.
            fabric: Material.
            betas: Of the body's shape, standard deviations.
            progress: Told while it runs.

        Raises:
            Diverged: the simulation diverged: positions or forces became infinite.
        """
        cloth = _cloth(pattern, len(panels))
        drape = self._dressed(panels, cloth, fabric, progress)
        target = np.asarray(betas, float)
        done = int(drape.report.steps)
        if target.any():
            for shape in range(1, SHAPES + 1):
                steps = DRESSING_STEPS if shape == SHAPES else SHAPE_STEPS
                drape = replace(drape, report=_nothing())
                share = target * shape / SHAPES
                drape = self._run(drape, cloth, fabric, self.settings, steps, progress, done, share)
                done += int(drape.report.steps)
        drape = replace(drape, report=replace(drape.report, steps=jnp.asarray(done)))
        return self._result(panels, drape)

    def lower_arms(
        self,
        vertices: Float[np.ndarray, "V 3"],
        pattern: Pattern,
        fabric: Fabric,
        betas: Float[np.ndarray, " b"],
        weights: Float[np.ndarray, "V J"],
        degrees: float,
        progress: StanceProgress | None = None,
    ) -> Simulated:
        """A drape on a body in T-pose, followed while the arms come down, in contact with itself.

        Args:
            vertices: The drape, metres.
            pattern: Its mesh and rest shape.
            fabric: What it is made of.
            betas: Shape of the body.
            weights: Skinning weights of the vertices.
            degrees: Of the arms below the horizontal.
            progress: Told after each stance.

        Raises:
            NotSettled: It does not come to rest.
            Diverged: The simulation diverged: positions or forces became infinite.
        """
        cloth = _cloth(pattern, len(vertices))
        laid = self._laid(vertices, cloth, betas)
        obstacle = StanceObstacle(self.obstacle, laid.betas)
        each = replace(self.equilibrium, max_steps=STANCE_STEPS)
        drape, steps = laid, 0
        for stance in lower_arms(laid, weights, degrees, cloth, fabric, obstacle, self.settings, each):
            drape = stance.drape
            steps += int(drape.report.steps)
            if progress is not None:
                progress(stance.degrees, float(drape.report.residual), drape.vertices)
        result = self._result(vertices, replace(drape, report=replace(drape.report, steps=jnp.asarray(steps))))
        if result.residual > NEARLY * result.tolerance:
            raise NotSettled(
                f"the garment does not come to rest with arms {degrees:g} degrees below the horizontal (residual "
                f"{result.residual:.3f}, at rest below {result.tolerance:g}): raise the arms, or take a looser garment"
            )
        return result

    def _laid(self, vertices: np.ndarray, cloth: Cloth, betas: np.ndarray) -> Drape:
        points = check_finite("vertices", np.asarray(vertices, np.float32))
        shape = np.asarray(betas, float)
        surface = self.obstacle.surface(shape)
        return Drape(start_state(points, cloth, surface), shape, surface, _nothing(), len(points))

    def _dressed(self, vertices: np.ndarray, cloth: Cloth, fabric: Fabric, progress: Progress | None) -> Drape:
        """On the mean body: seams and contact first without weight, then to rest."""
        points = check_finite("vertices", np.asarray(vertices, np.float32))
        mean = np.zeros(min(2, self.obstacle.body.num_betas))
        drape = dress(points, cloth, fabric, self.obstacle, self.settings, self.equilibrium, tuple(mean), PIECE)
        if progress is not None:
            progress(PIECE, float(drape.report.residual), drape.vertices)
        return self._run(drape, cloth, fabric, closing(self.settings), DRESSING_STEPS - PIECE, progress, PIECE)

    def _run(
        self,
        drape: Drape,
        cloth: Cloth,
        fabric: Fabric,
        settings: SolverSettings,
        most: int,
        progress: Progress | None,
        before: int,
        betas: np.ndarray | None = None,
    ) -> Drape:
        """Pieces of steps until the drape is at rest or `most` are done; the report counts them all."""
        shape = drape.betas if betas is None else betas
        steps = 0
        while steps < most and (steps == 0 or not drape.converged(self.equilibrium)):
            piece = replace(self.equilibrium, max_steps=min(PIECE, most - steps))
            drape = follow(drape, shape, cloth, fabric, self.obstacle, settings, piece)
            steps += int(drape.report.steps)
            if progress is not None:
                progress(before + steps, float(drape.report.residual), drape.vertices)
        return replace(drape, report=replace(drape.report, steps=jnp.asarray(before + steps)))

    def _result(self, start: np.ndarray, drape: Drape) -> Simulated:
        vertices = drape.vertices
        moved = np.linalg.norm(vertices - np.asarray(start, np.float32), axis=1)
        residual, steps = float(drape.report.residual), int(drape.report.steps)
        return Simulated(vertices, residual, self.equilibrium.tolerance, steps, moved)


def _cloth(pattern: Pattern, count: int) -> Cloth:
    return build_cloth(pattern.faces, pattern.uv, pattern.faces_uv, count)


def _nothing() -> StepReport:
    """The report of no steps: far from rest."""
    zero = jnp.zeros((), jnp.int32)
    return StepReport(jnp.asarray(jnp.inf), jnp.zeros(()), jnp.zeros(()), zero, zero)


def _worst_edge(vertices: np.ndarray, pattern: Pattern) -> tuple[float, np.ndarray]:
    """Largest ratio of an edge's length to that in the pattern, and its middle, metres."""
    ratio = edge_strain(vertices, pattern.faces, pattern.uv, pattern.faces_uv) + 1.0
    face, corner = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    ends = pattern.faces[face][[corner, (corner + 1) % 3]]
    return float(ratio[face, corner]), vertices[ends].mean(axis=0)
