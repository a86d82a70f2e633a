"""Implicit time stepping of cloth on a body, and its quasi-static end: equilibrium.

Each step is one Newton iteration of backward Euler with a positive definite tangent (Baraff and Witkin 1998 in
spirit). With `retention` 0 a step forgets its velocity and the iteration is a regularised Newton method for
equilibrium; with 1 it is dynamics.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.contact.surface import Surface
from tryon_jax.physics.block_matrix import BlockMatrix
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.coarse import CoarseInverse, invert_coarse
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.linear import conjugate_gradients
from tryon_jax.physics.self_contact import SelfPairs
from tryon_jax.physics.state import ClothState, SolverSettings
from tryon_jax.physics.system import System, assemble, residual, still_system
from tryon_jax.types import Scalar, pytree

COARSE_STEPS = 10
"""Steps for which one coarse correction is used; the cloth changes little meanwhile."""


@pytree
class StepReport:
    """How a step or a solve ended."""

    residual: Float[Array, ""]
    """Norm of the net force on all vertices over the norm of their weights plus contact loads."""
    move: Float[Array, ""]
    """Root mean square motion of the last step, metres."""
    depth: Float[Array, ""]
    """Deepest contact sample below the skin, metres (negative: all outside)."""
    steps: Int[Array, ""]
    iterations: Int[Array, ""]
    """Iterations of the linear solver, all steps together."""


def tangent_blocks(
    state: ClothState, cloth: Cloth, fabric: Fabric, surface: Surface, settings: SolverSettings
) -> BlockMatrix:
    """The positive definite matrix that a step from `state` solves with, N/m.

    Args:
        state: Where the cloth is.
        cloth: Rest state.
        fabric: Material.
        surface: The body.
        settings: Of the solver.
    """
    still = jnp.zeros_like(surface.vertices)
    return assemble(state, cloth, fabric, surface, settings, still).matrix


def step(
    state: ClothState,
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    settings: SolverSettings,
    surface_motion: Float[Array, "W 3"],
    pinned: Bool[Array, " V"] | None = None,
    pairs: SelfPairs | None = None,
    coarse: CoarseInverse | None = None,
) -> tuple[ClothState, StepReport]:
    """One implicit step; residual and depth in its report are those of `state`.

    Args:
        state: positions and velocities before the step.
        cloth: rest state.
        fabric: material.
        surface: the body.
        settings: of the step.
        surface_motion: how far each body vertex has moved since the last step, metres; friction drags the cloth along.
        pinned: vertices that stay exactly where they are; None leaves all free.
        pairs: parts of the cloth that must not pass through each other; None leaves self-contact out.
        coarse: coarse half of the preconditioner, for the same pins; None leaves it out.
    """
    system = assemble(state, cloth, fabric, surface, settings, surface_motion, pairs)
    state, move, iterations = _advance(state, system, cloth, settings, pinned, coarse)
    one = jnp.ones((), jnp.int32)
    return state, StepReport(residual(system, cloth, pinned), move, system.depth, one, iterations)


def _advance(
    state: ClothState,
    system: System,
    cloth: Cloth,
    settings: SolverSettings,
    pinned: Bool[Array, " V"] | None,
    coarse: CoarseInverse | None,
) -> tuple[ClothState, Float[Array, ""], Int[Array, ""]]:
    """The state after a step, the root mean square motion (metres), and the linear solver's iterations."""
    dtype = state.x.dtype
    move, iterations = conjugate_gradients(
        system.matrix,
        jnp.asarray(cloth.incidence.neighbours),
        system.right,
        jnp.asarray(settings.linear_tolerance, dtype),
        jnp.asarray(settings.linear_iterations, jnp.int32),
        coarse,
        pinned,
    )
    length = jnp.sqrt((move * move).sum(-1) + 1e-20)
    move = move * jnp.minimum(1.0, settings.max_move / length)[:, None]
    dragged = (system.plane * (move - system.motion)[:, None, :]).sum(-1)
    x, remainder = _add(state.x, state.remainder, move)
    new = ClothState(
        x=x,
        remainder=remainder,
        velocity=move / jnp.asarray(settings.time_step, dtype),
        slip=jnp.where((system.load > 0)[:, None], system.slip + dragged, 0.0),
        face=system.face,
    )
    return new, jnp.sqrt((move * move * cloth.active[:, None]).sum() / cloth.active.sum()), iterations


def _add(
    x: Float[Array, "V 3"], remainder: Float[Array, "V 3"], move: Float[Array, "V 3"]
) -> tuple[Float[Array, "V 3"], Float[Array, "V 3"]]:
    """`x + remainder + move` as a rounded sum and what it cuts off, exactly (Knuth's two-sum)."""
    small = remainder + move
    total = x + small
    seen = total - x
    return total, (x - (total - seen)) + (small - seen)


@pytree
class _Progress:
    """Between two steps: a state, and the system of the step that comes next."""

    state: ClothState
    report: StepReport
    system: System


def solve(
    state: ClothState,
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    settings: SolverSettings,
    surface_motion: Float[Array, "W 3"],
    pinned: Bool[Array, " V"] | None,
    tolerance: Scalar,
    max_steps: int | Int[Array, ""],
    pairs: SelfPairs | None = None,
) -> tuple[ClothState, StepReport]:
    """Step until the residual is below `tolerance` or `max_steps` are done; jittable, nothing is unrolled.

    The coarse half of the preconditioner is made anew every `COARSE_STEPS` steps.
    `surface_motion` applies to the first step only, which is always done: the body has moved once.

    Args:
        state: Where to start.
        cloth: Rest state.
        fabric: Material.
        surface: The body.
        settings: Of the steps.
        surface_motion: Motion of the body's vertices in the first step, metres; later steps have none.
        pinned: Vertices that stay exactly where `state` has them; None leaves all free.
        tolerance: Residual at which to stop: net force over weight plus contact load.
        max_steps: Steps at most.
        pairs: Vertices and faces of the cloth near each other; None leaves self-contact out.

    Returns:
        The last state, and its report; `move` is the last step's.
    """

    def running(progress: _Progress) -> Bool[Array, ""]:
        report = progress.report
        return ((report.residual > tolerance) | (report.steps < 1)) & (report.steps < max_steps)

    def advance(progress: _Progress, coarse: CoarseInverse | None) -> _Progress:
        before = progress.report
        # In the first pass there is nothing to move by yet: it makes the system of the first step. Made before the
        # loop, the system would be compiled twice.
        first = before.steps < 0
        moved, move, iterations = _advance(progress.state, progress.system, cloth, settings, pinned, coarse)
        state = jax.tree.map(lambda old, new: jnp.where(first, old, new), progress.state, moved)
        motion = jnp.where(first, surface_motion, 0.0)
        system = assemble(state, cloth, fabric, surface, settings, motion, pairs)
        now = residual(system, cloth, pinned)
        iterations = before.iterations + iterations
        report = StepReport(now, move, system.depth, before.steps + 1, iterations)
        return _Progress(state, report, system)

    def some_steps(progress: _Progress) -> _Progress:
        done = progress.report.steps
        coarse = None
        # Layers that touch make a fold sensitive to the last digits of each step; it keeps the solver it was tested
        # with.
        if pairs is None:
            neighbours = jnp.asarray(cloth.incidence.neighbours)
            coarse = invert_coarse(progress.system.matrix, neighbours, cloth.patches, pinned)
            coarse = replace(coarse, inverse=coarse.inverse * settings.coarse)
        until = jnp.where(done < 0, 0, done + COARSE_STEPS)

        def some(progress: _Progress) -> Bool[Array, ""]:
            return running(progress) & (progress.report.steps < until)

        return jax.lax.while_loop(some, lambda each: advance(each, coarse), progress)

    unknown, none = jnp.asarray(jnp.inf, state.x.dtype), jnp.zeros((), jnp.int32)
    start = StepReport(unknown, unknown, unknown, none - 1, none)
    progress = jax.lax.while_loop(running, some_steps, _Progress(state, start, still_system(state, cloth)))
    return progress.state, progress.report
