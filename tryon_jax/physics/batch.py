"""Many garments at once: drapes of one size bucket, settled side by side by one mapped solve.

On a GPU one garment leaves most of the device idle; a hundred take little longer than one. On a CPU nothing is gained:
there, run several processes. Each lane takes the same steps as alone, so that a sample does not depend on the others in
its batch; a lane that has come to rest waits, unchanged, for the others.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.contact.closest_points import closest_faces
from tryon_jax.contact.surface import Surface, move_surface, nearest_vertices
from tryon_jax.physics.body_contact import sample_points
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, closing, start_state, weightless
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.incidence import widen
from tryon_jax.physics.solver import StepReport, solve
from tryon_jax.physics.state import ClothState, SolverSettings

Tree = TypeVar("Tree")


def stack(trees: Sequence[Tree]) -> Tree:
    """Pytrees of equal shapes as one whose leaves have a leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *trees)


def stack_cloths(cloths: Sequence[Cloth]) -> Cloth:
    """Cloths of one bucket with a leading axis, their tables of incidence as long as the longest.

    Raises:
        ValueError: they are of different buckets.
    """
    sizes = sorted({cloth.vertex_areas.shape[0] for cloth in cloths})
    if len(sizes) != 1:
        raise ValueError(f"cloths must be of one size bucket to be stacked, got {sizes} padded vertices")
    tables = [cloth.incidence for cloth in cloths]
    counts = len(cloths[0].face_areas), len(cloths[0].hinge_shape)
    return stack([replace(cloth, incidence=widen(cloth.incidence, tables, *counts)) for cloth in cloths])


def stack_fabrics(fabrics: Sequence[Fabric]) -> Fabric:
    """Fabrics with a leading axis; their names, which are no arrays, go."""
    return stack([fabric.unnamed for fabric in fabrics])


@jax.jit
def solve_many(
    states: ClothState,
    cloths: Cloth,
    fabrics: Fabric,
    surface: Surface,
    bodies: Float[Array, "B W 3"],
    settings: SolverSettings,
    motions: Float[Array, "B W 3"],
    tolerance: Float[Array, ""],
    max_steps: Int[Array, " B"],
    pinned: Bool[Array, "B V"] | None = None,
) -> tuple[ClothState, StepReport]:
    """`solver.solve` for B garments.

    Args:
        states: of the garments, stacked.
        cloths: their rest states, stacked.
        fabrics: their materials, stacked.
        surface: topology of the body that all lanes share.
        bodies: vertices of each lane's body, metres.
        settings: of the solver.
        motions: how far each body has moved since the last step, metres.
        tolerance: residual at which a lane stops.
        max_steps: of each lane; a lane with none is handed back as it is.
        pinned: vertices of each lane that stay exactly where they are; None leaves all free.
    """

    def one(
        state: ClothState,
        cloth: Cloth,
        fabric: Fabric,
        body: jax.Array,
        motion: jax.Array,
        most: jax.Array,
        held: jax.Array | None,
    ) -> tuple[ClothState, StepReport]:
        return solve(state, cloth, fabric, move_surface(surface, body), settings, motion, held, tolerance, most)

    return jax.vmap(one)(states, cloths, fabrics, bodies, motions, max_steps, pinned)


@jax.jit
def _sample_many(states: ClothState, cloths: Cloth) -> Float[Array, "B S 3"]:
    return jax.vmap(sample_points)(states.x, cloths)


@jax.jit
def _faces_many(
    surface: Surface, bodies: Float[Array, "B W 3"], points: Float[Array, "B S 3"], vertex: Int[Array, "B S"]
) -> Int[Array, "B S"]:
    return jax.vmap(lambda b, p, v: closest_faces(replace(surface, vertices=b), p, v))(bodies, points, vertex)


@dataclass(frozen=True, eq=False)
class _Lanes:
    """Drapes side by side."""

    states: ClothState
    betas: Float[np.ndarray, "B b"]
    surfaces: list[Surface]
    reports: list[StepReport]
    counts: tuple[int, ...]

    def split(self) -> list[Drape]:
        """The drapes one by one."""
        states = [jax.tree.map(lambda leaf, k=k: leaf[k], self.states) for k in range(len(self.counts))]
        parts = zip(states, self.betas, self.surfaces, self.reports, self.counts, strict=True)
        return [Drape(*part) for part in parts]


def dress_many(
    starts: Sequence[Float[np.ndarray, "_ 3"]],
    cloths: Sequence[Cloth],
    fabrics: Sequence[Fabric],
    obstacle: Obstacle,
    settings: SolverSettings,
    equilibrium: Equilibrium,
    betas: Sequence[float] = (0.0, 0.0),
    max_steps: int = 400,
) -> list[Drape]:
    """`dressing.dress` for garments of one bucket on one body shape.

    A lane that diverges comes back with a residual that is not finite; the others are unharmed.

    Args:
        starts: Starting positions of each garment, metres.
        cloths: Rest state of each.
        fabrics: Material of each.
        obstacle: The body.
        settings: Of the solver.
        equilibrium: When a drape counts as at rest.
        betas: Of the body's shape, standard deviations.
        max_steps: Steps at most.

    Raises:
        ValueError: the cloths are of different buckets.
    """
    settings = closing(settings)
    shape = np.asarray(betas, float)
    surface = obstacle.surface(shape)
    states = stack([start_state(start, cloth, surface) for start, cloth in zip(starts, cloths, strict=True)])
    counts = tuple(len(start) for start in starts)
    shapes = np.broadcast_to(shape, (len(counts), len(shape)))
    lanes = _Lanes(states, shapes, [surface] * len(counts), [], counts)
    stacked, cloth_fabrics = stack_cloths(cloths), stack_fabrics(fabrics)
    lanes = _settle_many(lanes, stacked, cloth_fabrics, weightless(settings), 1e-3, 20, 10, None)
    zero = jnp.zeros_like(lanes.states.x)
    lanes = replace(lanes, states=replace(lanes.states, velocity=zero, slip=zero))
    goal, refresh = equilibrium.tolerance, equilibrium.refresh
    return _settle_many(lanes, stacked, cloth_fabrics, settings, goal, max_steps, refresh, None).split()


def relax_many(
    starts: Sequence[Float[np.ndarray, "_ 3"]],
    slips: Sequence[Float[np.ndarray, "_ 3"]],
    betas: Float[np.ndarray, "B b"],
    cloths: Sequence[Cloth],
    fabrics: Sequence[Fabric],
    obstacle: Obstacle,
    settings: SolverSettings,
    equilibrium: Equilibrium,
    max_steps: int = 200,
) -> list[Drape]:
    """`dressing.relax` for garments of one bucket, each on its own body shape.

    A lane that diverges comes back with a residual that is not finite; the others are unharmed.

    Args:
        starts: Starting positions of each garment, metres.
        slips: Elastic slip of each vertex on the body, metres.
        betas: Body shape of each garment, standard deviations.
        cloths: Rest state of each.
        fabrics: Material of each.
        obstacle: The body.
        settings: Of the solver.
        equilibrium: When a drape counts as at rest.
        max_steps: Steps at most.

    Raises:
        ValueError: The cloths are of different buckets.
    """
    surfaces = [obstacle.surface(shape) for shape in betas]
    parts = zip(starts, cloths, surfaces, slips, strict=True)
    states = stack([start_state(*part) for part in parts])
    lanes = _Lanes(states, np.asarray(betas, float), surfaces, [], tuple(len(start) for start in starts))
    goal, refresh = equilibrium.tolerance, equilibrium.refresh
    stacked, cloth_fabrics = stack_cloths(cloths), stack_fabrics(fabrics)
    return _settle_many(lanes, stacked, cloth_fabrics, settings, goal, max_steps, refresh, None).split()


def sweep_many(
    drapes: Sequence[Drape],
    rays: Float[np.ndarray, "B N b"],
    cloths: Sequence[Cloth],
    fabrics: Sequence[Fabric],
    obstacle: Obstacle,
    settings: SolverSettings,
    equilibrium: Equilibrium,
) -> Iterator[list[Drape]]:
    """`dressing.sweep` for garments of one bucket, each along its own ray; yields all lanes at each shape.

    A lane that diverges comes back with a residual that is not finite; the others are unharmed.

    Args:
        drapes: Where each garment starts.
        rays: Body shapes along the ray of each garment, standard deviations.
        cloths: Rest state of each.
        fabrics: Material of each.
        obstacle: The body.
        settings: Of the solver.
        equilibrium: When a drape counts as at rest.

    Raises:
        ValueError: the cloths are of different buckets.
    """
    stacked, cloth_fabrics = stack_cloths(cloths), stack_fabrics(fabrics)
    counts = tuple(drape.num_vertices for drape in drapes)
    surfaces, betas = [drape.surface for drape in drapes], np.stack([drape.betas for drape in drapes])
    lanes = _Lanes(stack([drape.state for drape in drapes]), betas, surfaces, [], counts)
    for shapes in np.moveaxis(np.asarray(rays, float), 1, 0):
        surfaces = [obstacle.surface(shape) for shape in shapes]
        pairs = zip(surfaces, lanes.surfaces, strict=True)
        motions = jnp.stack([jnp.asarray(new.vertices) - jnp.asarray(old.vertices) for new, old in pairs])
        moved = replace(lanes, betas=shapes, surfaces=surfaces)
        goal, most, refresh = equilibrium.tolerance, equilibrium.max_steps, equilibrium.refresh
        lanes = _settle_many(moved, stacked, cloth_fabrics, settings, goal, most, refresh, motions)
        yield lanes.split()


def _settle_many(
    lanes: _Lanes,
    cloths: Cloth,
    fabrics: Fabric,
    settings: SolverSettings,
    tolerance: float,
    max_steps: int,
    refresh: int,
    motions: jnp.ndarray | None,
) -> _Lanes:
    """Solve in pieces of `refresh` steps until every lane is at rest, searching closest points anew between them."""
    count = len(lanes.counts)
    surface = lanes.surfaces[0]
    bodies = jnp.stack([jnp.asarray(s.vertices) for s in lanes.surfaces])
    still = jnp.zeros_like(bodies)
    motions = still if motions is None else motions
    goal = jnp.asarray(tolerance, lanes.states.x.dtype)
    states = lanes.states
    table = {name: np.full(count, np.inf) for name in ("residual", "move", "depth")}
    table |= {name: np.zeros(count, int) for name in ("steps", "iterations")}
    while True:
        waiting = (table["steps"] > 0) & ~(table["residual"] > tolerance)
        most = np.where(waiting, 0, np.minimum(refresh, max_steps - table["steps"]))
        if not most.any():
            break
        points = _sample_many(states, cloths)
        vertex = jnp.stack([jnp.asarray(nearest_vertices(*pair)) for pair in zip(lanes.surfaces, points, strict=True)])
        states = replace(states, face=_faces_many(surface, bodies, points, vertex))
        steps = jnp.asarray(most, jnp.int32)
        states, report = solve_many(states, cloths, fabrics, surface, bodies, settings, motions, goal, steps)
        motions = still
        for name in ("residual", "move", "depth"):
            table[name] = np.where(most > 0, np.asarray(getattr(report, name)), table[name])
        for name in ("steps", "iterations"):
            table[name] = table[name] + np.asarray(getattr(report, name))
        lost = ~np.isfinite(np.asarray(states.x)).all(axis=(1, 2))
        table["residual"] = np.where(lost, np.nan, table["residual"])
    reports = []
    for k in range(count):
        floats = [jnp.asarray(table[name][k], jnp.float32) for name in ("residual", "move", "depth")]
        whole = [jnp.asarray(table[name][k], jnp.int32) for name in ("steps", "iterations")]
        reports.append(StepReport(*floats, *whole))
    return replace(lanes, states=states, reports=reports)
