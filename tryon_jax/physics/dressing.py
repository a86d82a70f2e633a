"""Dressing a body with a garment, and following the body's shape, each to equilibrium. Host side, around the jitted
solver.

Friction makes a drape depend on its path by millimetres, so every shape is reached along a straight ray of betas from
the mean body outwards: the result is then a function of the shape, not of the order in which shapes were visited.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tryon_jax.body import shape_body
from tryon_jax.contact.closest_points import closest_faces
from tryon_jax.contact.surface import Surface, build_surface, move_surface, nearest_vertices
from tryon_jax.physics.body_contact import sample_points
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.proxy import CollisionBody, build_collision_body
from tryon_jax.physics.self_contact import SelfContact, SelfPairs, find_pairs
from tryon_jax.physics.solver import StepReport, solve
from tryon_jax.physics.state import ClothState, SolverSettings, resting
from tryon_jax.types import Body

Found = TypeVar("Found")
FAR_AWAY = 5.0
"""Metres from the body where padding vertices rest."""
_solve = jax.jit(solve)
_closest_faces = jax.jit(lambda surface, x, cloth, vertex: closest_faces(surface, sample_points(x, cloth), vertex))
_move_surface = jax.jit(move_surface)
_sample_points = jax.jit(sample_points)


class Diverged(ValueError):
    """Positions or forces became infinite: a broken mesh, or a body that the garment cannot be put on."""


def until_diverged(found: Iterator[Found]) -> Iterator[Found]:
    """What a simulation yields before it diverges, if it does."""
    try:
        yield from found
    except Diverged:
        return


@dataclass(frozen=True)
class Equilibrium:
    """When a drape counts as at rest."""

    tolerance: float = 1e-2
    """Net force over weight plus contact load (norms over all vertices)."""
    max_steps: int = 120
    """Steps for one body shape at most."""
    refresh: int = 30
    """Steps after which closest body points are searched anew, among all."""


class Obstacle:
    """The collision surface of one body for any betas."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self.collision: CollisionBody = build_collision_body(body)
        self._surface = build_surface(self._vertices(np.zeros(1)), self.collision.faces)
        self._shape = jax.jit(lambda betas: shape_body(body, betas)[0])

    def _vertices(self, betas: np.ndarray) -> jnp.ndarray:
        skin = shape_body(self.body, jnp.asarray(betas, jnp.float32))[0]
        return jnp.asarray(self.collision.vertices(np.asarray(skin)), jnp.float32)

    def surface(self, betas: Float[np.ndarray, " b"]) -> Surface:
        """Collision surface for `betas`."""
        skin = np.asarray(self._shape(jnp.asarray(betas, jnp.float32)))
        return self.moved(self._surface, self.collision.vertices(skin))

    @staticmethod
    def moved(surface: Surface, vertices: Float[np.ndarray, "W 3"]) -> Surface:
        """The surface with its vertices elsewhere, metres."""
        return _move_surface(surface, jnp.asarray(vertices, jnp.float32))

    def skin(self, betas: Float[np.ndarray, " b"]) -> Float[np.ndarray, "V 3"]:
        """The body's own vertices for `betas`, metres."""
        return np.asarray(self._shape(jnp.asarray(betas, jnp.float32)))


@dataclass(frozen=True, eq=False)
class Drape:
    """A garment at rest, or as close to rest as the solver came, on one body shape."""

    state: ClothState
    betas: Float[np.ndarray, " b"]
    surface: Surface
    report: StepReport
    num_vertices: int

    @property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Positions without padding, metres."""
        return np.asarray(self.state.x)[: self.num_vertices]

    def converged(self, equilibrium: Equilibrium) -> bool:
        """True when the residual is within the tolerance."""
        return float(self.report.residual) <= equilibrium.tolerance


def dress(
    start: Float[np.ndarray, "V 3"],
    cloth: Cloth,
    fabric: Fabric,
    obstacle: Obstacle,
    settings: SolverSettings,
    equilibrium: Equilibrium,
    betas: Sequence[float] = (0.0, 0.0),
    max_steps: int = 400,
    self_contact: SelfContact | None = None,
) -> Drape:
    """Drape a sewn garment from flat panels around the body, on one body shape.

    The panels start partly inside the body: signed contact pushes them out while seams close, first without gravity,
    then with it.

    Args:
        start: positions of the welded vertices, metres (`tryon_jax.garment.placement`).
        cloth: rest state.
        fabric: material.
        obstacle: the body.
        settings: of the solver.
        equilibrium: when a drape counts as at rest.
        betas: of the body's shape, standard deviations.
        max_steps: steps in all.
        self_contact: keeps the cloth from passing through itself; None leaves it out (see `physics.self_contact`).

    Raises:
        Diverged: positions or forces became infinite (a garment that cannot be dressed, or a broken mesh).
    """
    settings = closing(settings)
    shape = np.asarray(betas, float)
    surface = obstacle.surface(shape)
    drape = Drape(start_state(start, cloth, surface), shape, surface, _no_report(), len(start))
    drape = _settle(drape, cloth, fabric, weightless(settings), 1e-3, 20, 10, None)
    zero = jnp.zeros_like(drape.state.x)
    drape = replace(drape, state=replace(drape.state, velocity=zero, slip=zero))
    refresh, goal = equilibrium.refresh, equilibrium.tolerance
    return _settle(drape, cloth, fabric, settings, goal, max_steps, refresh, None, self_contact)


def relax(
    start: Float[np.ndarray, "V 3"],
    slip: Float[np.ndarray, "V 3"],
    betas: Float[np.ndarray, " b"],
    cloth: Cloth,
    fabric: Fabric,
    obstacle: Obstacle,
    settings: SolverSettings,
    equilibrium: Equilibrium,
    max_steps: int = 200,
    self_contact: SelfContact | None = None,
    pairs: SelfPairs | None = None,
) -> Drape:
    """Bring a garment to rest from positions near a drape, such as those of another mesh or design.

    Args:
        start: Positions of the welded vertices, metres.
        slip: Elastic slip of friction at the same vertices, metres.
        betas: Shape of the body.
        cloth: The garment's rest state.
        fabric: Its fabric.
        obstacle: The body.
        settings: Of the solver.
        equilibrium: When it counts as at rest.
        max_steps: Steps in all.
        self_contact: As in `dress`.
        pairs: Of the drape that it is near to, from `self_pairs`: on which side of each other parts of the cloth were.

    Raises:
        Diverged: Positions or forces became infinite.
    """
    shape = np.asarray(betas, float)
    surface = obstacle.surface(shape)
    drape = Drape(start_state(start, cloth, surface, slip), shape, surface, _no_report(), len(start))
    goal, refresh = equilibrium.tolerance, equilibrium.refresh
    return _settle(drape, cloth, fabric, settings, goal, max_steps, refresh, None, self_contact, pairs)


def self_pairs(drape: Drape, cloth: Cloth, self_contact: SelfContact) -> SelfPairs:
    """Which parts of a drape are near each other, and on which side.

    Args:
        drape: The drape.
        cloth: Rest state.
        self_contact: What is near.
    """
    return _pairs(drape.state, cloth, drape.num_vertices, self_contact, None)


def follow(
    drape: Drape,
    betas: Float[np.ndarray, " b"],
    cloth: Cloth,
    fabric: Fabric,
    obstacle: Obstacle,
    settings: SolverSettings,
    equilibrium: Equilibrium,
    self_contact: SelfContact | None = None,
) -> Drape:
    """Move a drape to a similar body shape and bring it to rest.

    Args:
        drape: Where to start.
        betas: Of the other body shape, standard deviations.
        cloth: Rest state.
        fabric: Material.
        obstacle: The body.
        settings: Of the solver.
        equilibrium: When a drape counts as at rest.
        self_contact: Contact of the cloth with itself; None leaves it out.

    Raises:
        Diverged: positions or forces became infinite.
    """
    surface = obstacle.surface(np.asarray(betas, float))
    motion = jnp.asarray(surface.vertices) - jnp.asarray(drape.surface.vertices)
    moved = replace(drape, betas=np.asarray(betas, float), surface=surface, report=_no_report())
    goal, most, refresh = equilibrium.tolerance, equilibrium.max_steps, equilibrium.refresh
    return _settle(moved, cloth, fabric, settings, goal, most, refresh, motion, self_contact)


def sweep(
    drape: Drape,
    ray: Float[np.ndarray, "N b"],
    cloth: Cloth,
    fabric: Fabric,
    obstacle: Obstacle,
    settings: SolverSettings,
    equilibrium: Equilibrium,
    self_contact: SelfContact | None = None,
) -> Iterator[Drape]:
    """Drapes along a ray of betas, in its order, each from the one before.

    Args:
        drape: Where to start.
        ray: Body shapes in order, standard deviations.
        cloth: Rest state.
        fabric: Material.
        obstacle: The body.
        settings: Of the solver.
        equilibrium: When a drape counts as at rest.
        self_contact: Contact of the cloth with itself; None leaves it out.

    Raises:
        Diverged: Positions or forces became infinite.
    """
    for betas in ray:
        drape = follow(drape, betas, cloth, fabric, obstacle, settings, equilibrium, self_contact)
        yield drape


def start_state(
    start: Float[np.ndarray, "_ 3"], cloth: Cloth, surface: Surface, slip: Float[np.ndarray, "_ 3"] | None = None
) -> ClothState:
    """A cloth without velocity at `start` (metres, without padding), its padding far away; no `slip` by default.

    Args:
        start: Positions without padding, metres.
        cloth: Rest state.
        surface: The body.
        slip: Elastic slip of each vertex on the body, metres; none when None.
    """
    x = np.full((cloth.vertex_areas.shape[0], 3), FAR_AWAY, np.float32)
    x[: len(start)] = start
    state = resting(jnp.asarray(x), _faces(surface, jnp.asarray(x), cloth))
    if slip is None:
        return state
    padded = np.zeros_like(x)
    padded[: len(slip)] = slip
    return replace(state, slip=jnp.asarray(padded))


def closing(settings: SolverSettings) -> SolverSettings:
    """Settings of dressing: patches moved as wholes push layers through each other while seams close."""
    return replace(settings, coarse=0.0)


def weightless(settings: SolverSettings) -> SolverSettings:
    """Settings of the first steps of dressing, in which seams close and the cloth leaves the body."""
    return replace(settings, gravity=0.0, retention=0.0)


def _faces(surface: Surface, x: jnp.ndarray, cloth: Cloth) -> jnp.ndarray:
    vertex = nearest_vertices(surface, _sample_points(x, cloth))
    return _closest_faces(surface, x, cloth, vertex)


def _pairs(
    state: ClothState, cloth: Cloth, num_vertices: int, settings: SelfContact, previous: SelfPairs | None
) -> SelfPairs:
    faces = np.asarray(cloth.faces)[np.asarray(cloth.face_areas) > 0]
    capacity = settings.capacity if previous is None else len(previous.vertex)
    while True:
        pairs, overflow = find_pairs(np.asarray(state.x)[:num_vertices], faces, settings, capacity, previous)
        if not overflow:
            return pairs
        capacity *= 2


def _no_report() -> StepReport:
    zero = jnp.zeros((), jnp.int32)
    return StepReport(jnp.asarray(jnp.inf), jnp.zeros(()), jnp.zeros(()), zero, zero)


def _settle(
    drape: Drape,
    cloth: Cloth,
    fabric: Fabric,
    settings: SolverSettings,
    tolerance: float,
    max_steps: int,
    refresh: int,
    motion: jnp.ndarray | None,
    self_contact: SelfContact | None = None,
    pairs: SelfPairs | None = None,
) -> Drape:
    """Solve in pieces of `refresh` steps, searching closest points anew between them."""
    state, report = drape.state, drape.report
    still = jnp.zeros_like(drape.surface.vertices)
    motion = still if motion is None else motion
    steps = iterations = 0
    if self_contact is not None:
        refresh = min(refresh, self_contact.refresh)
    while steps < max_steps and (steps == 0 or float(report.residual) > tolerance):
        state = replace(state, face=_faces(drape.surface, state.x, cloth))
        if self_contact is not None:
            pairs = _pairs(state, cloth, drape.num_vertices, self_contact, pairs)
        piece = jnp.asarray(min(refresh, max_steps - steps), jnp.int32)
        goal = jnp.asarray(tolerance, state.x.dtype)
        state, report = _solve(state, cloth, fabric.unnamed, drape.surface, settings, motion, None, goal, piece, pairs)
        motion = still
        steps, iterations = steps + int(report.steps), iterations + int(report.iterations)
        # The linear solver stops at NaN: positions may stay finite where forces are not.
        if not (np.isfinite(np.asarray(state.x)).all() and np.isfinite(float(report.residual))):
            where = f"fabric {fabric.name!r}, {drape.num_vertices} vertices, betas {drape.betas.tolist()}"
            raise Diverged(f"the drape diverged after {steps} steps: {where}")
    total = replace(report, steps=jnp.asarray(steps), iterations=jnp.asarray(iterations))
    return replace(drape, state=state, report=total)
