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
from tryon_jax.physics.bending import dihedral_angles, hinge_hessian, hinge_stiffness
from tryon_jax.physics.body_contact import (
    Contact,
    ContactLaw,
    contact_forces,
    friction,
    normal_gradient,
    normal_hessian,
)
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.coarse import CoarseInverse, invert_coarse
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.linear import conjugate_gradients
from tryon_jax.physics.self_contact import SelfPairs, self_contact
from tryon_jax.physics.stretch import deformation_gradients, face_gradient, face_hessian, green_strain, stress
from tryon_jax.types import EXACT, ArrayLike, Scalar, pytree

GRAVITY = 9.81
"""m/s², along −y."""
COARSE_STEPS = 10
"""Steps for which one coarse correction is used; the cloth changes little meanwhile."""


@pytree
class SolverSettings:
    """Parameters of the solver; changing them compiles nothing."""

    time_step: Scalar = 1 / 30
    """Seconds."""
    retention: Scalar = 0.9
    """Share of the velocity that a step keeps: 1 is dynamics, 0 quasi-static."""
    gravity: Scalar = GRAVITY
    """m/s²."""
    max_move: Scalar = 8e-3
    """Metres that a vertex may move in one step."""
    contact_margin: Scalar = 5e-4
    """Metres deeper at which the contact stiffness is read."""
    linear_tolerance: Scalar = 0.15
    """Relative residual of the linear solve."""
    linear_iterations: int | Int[ArrayLike, ""] = 300
    law: ContactLaw = ContactLaw()
    coarse: Scalar = 1.0
    """Share of the coarse correction in the preconditioner; 0 leaves the diagonal blocks alone."""


@pytree
class ClothState:
    """Everything that a step changes; store all of it to continue a drape (friction remembers its slip)."""

    x: Float[Array, "V 3"]
    """Positions, metres, to the precision of their type."""
    remainder: Float[Array, "V 3"]
    """What single precision cuts off, metres: the cloth is at `x + remainder`. Without it, single precision moves the
    corners of stiff cloth by forces that are larger than the tolerance, and no step brings it to rest."""
    velocity: Float[Array, "V 3"]
    slip: Float[Array, "V 3"]
    """Elastic slip of friction, metres."""
    face: Int[Array, " S"]
    """Closest body face of each contact sample."""


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


def resting(x: Float[Array, "V 3"], face: Int[Array, " S"]) -> ClothState:
    """A state at rest at `x` (metres), its contact samples nearest to `face`."""
    zero = jnp.zeros_like(x)
    return ClothState(x, zero, zero, zero, face)


def internal_forces(
    x: Float[Array, "V 3"], cloth: Cloth, fabric: Fabric, remainder: Float[Array, "V 3"] | None = None
) -> tuple[Float[Array, "V 3"], Float[Array, "F 3 3 3 3"], Float[Array, "H 14 3 3"]]:
    """Gradient of stretch and bending (newtons) and their element stiffness blocks (N/m).

    Bending is computed at `x`; stretch, which is stiffer by far, at `x + remainder`.

    Args:
        x: Vertices, metres.
        cloth: Rest state.
        fabric: Material.
        remainder: What rounding took from `x`, metres; nothing when None.
    """
    gradients = deformation_gradients(x, cloth, remainder)
    strain = green_strain(gradients)
    s = stress(strain, fabric)
    theta, slope = dihedral_angles(x, cloth)
    weight = hinge_stiffness(theta, cloth, fabric) * cloth.hinge_shape
    gradient = jnp.zeros_like(x).at[cloth.faces].add(face_gradient(gradients, s, cloth))
    gradient = gradient.at[cloth.hinges].add((weight * theta)[:, None, None] * slope)
    return gradient, face_hessian(gradients, strain, s, cloth, fabric), hinge_hessian(weight, slope)


@pytree
class _System:
    """The linear system of a step, and what the step needs once it is solved."""

    blocks: Float[Array, "V K 3 3"]
    right: Float[Array, "V 3"]
    gradient: Float[Array, "V 3"]
    contact: Contact
    slip: Float[Array, "V 3"]
    tangent: Float[Array, "V 3 3"]
    motion: Float[Array, "V 3"]
    mass: Float[Array, " V"]


def _assemble(
    state: ClothState,
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    settings: SolverSettings,
    surface_motion: Float[Array, "W 3"],
    pairs: SelfPairs | None,
) -> _System:
    dtype = state.x.dtype
    h = jnp.asarray(settings.time_step, dtype)
    count, slots = cloth.neighbours.shape
    mass = cloth.vertex_areas * jnp.asarray(fabric.density, dtype)

    gradient, face_blocks, hinge_blocks = internal_forces(state.x, cloth, fabric, state.remainder)
    contact = contact_forces(state.x, state.face, cloth, fabric, surface, settings.law, settings.contact_margin)
    slip, grip, tangent = friction(state.slip, contact, cloth, fabric, settings.law)
    at_vertices, at_faces = normal_hessian(contact, cloth)

    weight = jnp.zeros_like(state.x).at[:, 1].set(mass * settings.gravity)
    gradient = gradient + weight + normal_gradient(contact, cloth)
    gradient = gradient + (settings.law.tangential * cloth.vertex_areas)[:, None] * slip

    inertia = jnp.where(cloth.active > 0, mass / (h * h), 1.0)
    diagonal = at_vertices + grip[:, None, None] * tangent
    diagonal = diagonal + inertia[:, None, None] * jnp.eye(3, dtype=dtype)[None]
    if pairs is not None:
        law, margin = settings.law, settings.contact_margin
        between, held = self_contact(state.x, pairs, cloth.vertex_areas, law, margin)
        gradient, diagonal = gradient + between, diagonal + held
    face_blocks = face_blocks + at_faces[:, None, None]
    blocks = jnp.zeros((count * slots, 9), dtype)
    blocks = blocks.at[cloth.face_slots.reshape(-1)].add(face_blocks.reshape(-1, 9))
    blocks = blocks.at[cloth.hinge_slots.reshape(-1)].add(hinge_blocks.reshape(-1, 9))
    blocks = blocks.reshape(count, slots, 3, 3).at[:, 0].add(diagonal)

    corners = surface.faces[contact.point.face[:count]]
    motion = jnp.einsum("vk,vkc->vc", contact.point.barycentric[:count], surface_motion[corners], precision=EXACT)
    drag = grip[:, None] * (tangent * motion[:, None, :]).sum(-1)
    right = (mass / h * settings.retention)[:, None] * state.velocity - gradient + drag
    right = jnp.asarray(right * cloth.active[:, None])
    return _System(blocks, right, gradient, contact, slip, tangent, motion, jnp.asarray(mass))


def tangent_blocks(
    state: ClothState, cloth: Cloth, fabric: Fabric, surface: Surface, settings: SolverSettings
) -> Float[Array, "V K 3 3"]:
    """Blocks of the positive definite matrix that a step from `state` solves with, N/m.

    Args:
        state: Where the cloth is.
        cloth: Rest state.
        fabric: Material.
        surface: The body.
        settings: Of the solver.
    """
    still = jnp.zeros_like(surface.vertices)
    return _assemble(state, cloth, fabric, surface, settings, still, None).blocks


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
    """One implicit step.

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
    dtype = state.x.dtype
    system = _assemble(state, cloth, fabric, surface, settings, surface_motion, pairs)
    contact, mass = system.contact, system.mass
    move, iterations = conjugate_gradients(
        system.blocks,
        jnp.asarray(cloth.neighbours),
        system.right,
        jnp.asarray(settings.linear_tolerance, dtype),
        jnp.asarray(settings.linear_iterations, jnp.int32),
        coarse,
        pinned,
    )
    length = jnp.sqrt((move * move).sum(-1) + 1e-20)
    move = move * jnp.minimum(1.0, settings.max_move / length)[:, None]
    dragged = (system.tangent * (move - system.motion)[:, None, :]).sum(-1)
    x, remainder = _add(state.x, state.remainder, move)
    new = ClothState(
        x=x,
        remainder=remainder,
        velocity=move / jnp.asarray(settings.time_step, dtype),
        slip=jnp.where((contact.load > 0)[:, None], system.slip + dragged, 0.0),
        face=contact.point.face,
    )
    free = (cloth.active if pinned is None else jnp.where(pinned, 0.0, cloth.active))[:, None]
    scale = jnp.linalg.norm(mass * GRAVITY * cloth.active) + jnp.linalg.norm(contact.load)
    shape_weight = jnp.concatenate([cloth.vertex_areas, cloth.face_areas])
    report = StepReport(
        residual=jnp.linalg.norm(system.gradient * free) / scale,
        move=jnp.sqrt((move * move * cloth.active[:, None]).sum() / cloth.active.sum()),
        depth=jnp.max(jnp.where(shape_weight > 0, -contact.point.height, -1.0)),
        steps=jnp.ones((), jnp.int32),
        iterations=iterations,
    )
    return new, report


def _add(
    x: Float[Array, "V 3"], remainder: Float[Array, "V 3"], move: Float[Array, "V 3"]
) -> tuple[Float[Array, "V 3"], Float[Array, "V 3"]]:
    """`x + remainder + move` as a rounded sum and what it cuts off, exactly (Knuth's two-sum)."""
    small = remainder + move
    total = x + small
    seen = total - x
    return total, (x - (total - seen)) + (small - seen)


_Progress = tuple[ClothState, StepReport, Float[Array, "W 3"]]


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
    `surface_motion` applies to the first step only: the body has moved once.

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
        The last state, and the report of its step.
    """
    zero = jnp.zeros((), jnp.int32)
    unknown = jnp.asarray(jnp.inf, state.x.dtype)
    start = StepReport(unknown, unknown, unknown, zero, zero)

    def running(carry: _Progress) -> Bool[Array, ""]:
        _, report, _ = carry
        return (report.residual > tolerance) & (report.steps < max_steps)

    def advance(carry: _Progress, coarse: CoarseInverse | None) -> _Progress:
        state, before, motion = carry
        state, report = step(state, cloth, fabric, surface, settings, motion, pinned, pairs, coarse)
        total = StepReport(
            report.residual,
            report.move,
            report.depth,
            before.steps + report.steps,
            before.iterations + report.iterations,
        )
        return state, total, jnp.zeros_like(motion)

    def some_steps(carry: _Progress) -> _Progress:
        state, before, motion = carry
        # The first step assembles the same once more: a second copy of the step would double what is compiled.
        system = _assemble(state, cloth, fabric, surface, settings, motion, pairs)
        coarse = invert_coarse(system.blocks, jnp.asarray(cloth.neighbours), cloth.patches, pinned)
        coarse = replace(coarse, inverse=coarse.inverse * settings.coarse)
        until = before.steps + COARSE_STEPS
        return jax.lax.while_loop(lambda c: running(c) & (c[1].steps < until), lambda c: advance(c, coarse), carry)

    # Layers that touch make a fold sensitive to the last digits of each step; it keeps the solver it was tested with.
    body = some_steps if pairs is None else lambda carry: advance(carry, None)
    state, report, _ = jax.lax.while_loop(running, body, (state, start, surface_motion))
    return state, report
