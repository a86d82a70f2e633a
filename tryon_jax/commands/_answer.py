"""Requests answered by a session: what is done to a drape, in which order, and when it is refused."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from tryon_jax.body.measurements import check_measurement
from tryon_jax.checks import check_choice, check_file
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._request import Request, check_shape, resolve_betas, resolve_design
from tryon_jax.contact.push_out import CLEARANCE
from tryon_jax.physics.fabrics import fabric_names
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.gate import judge_betas
from tryon_jax.wear.own import OwnOptions
from tryon_jax.wear.session import Session


@dataclass(frozen=True)
class Treatment:
    """What is done to every garment of a command."""

    push_out: bool = True
    refine: bool = False
    """Bring the learned drape to rest by simulation."""
    steps: int | None = None
    """Of it; None to rest."""
    simulate: bool = False
    """Drape by simulation alone."""
    gate: bool = True
    """Refuse what is torn or lies in the body."""
    own: OwnOptions = field(default_factory=OwnOptions)
    seed: int = 0

    def fabrics(self, session: Session) -> Sequence[str]:
        """What can be asked for: the simulator knows more fabrics than the networks."""
        return fabric_names() if self.simulate or self.refine else session.fabrics


def check(session: Session, request: Request, treatment: Treatment) -> None:
    """Raise for a request that cannot be answered, as far as that can be told without draping.

    Raises:
        ValueError: an unknown fabric or design, numbers out of range, or betas far from what the networks know.
        FileNotFoundError: there is no such mesh.
    """
    check_choice("fabric", request.fabric or session.fabrics[0], treatment.fabrics(session))
    if request.mesh is None:
        resolve_design(session.space, request.cut)
    else:
        check_file("garment", request.mesh)
    measurements = request.shape.measurements()
    for name, value in measurements.items():
        check_measurement(name, value)
    check_shape(request.shape)
    if not measurements:
        betas, _ = resolve_betas(session.body, request.shape, session.num_betas)
        if session.other is None and treatment.gate:
            judge_betas(betas, session.model.config.beta_ranges).check("this body")


def answer(
    session: Session, request: Request, treatment: Treatment, clock: Clock, pose: Float[np.ndarray, "J 3"] | None = None
) -> tuple[DressedBody, list[str]]:
    """The dressed body of one request, and what there is to say about its shape.

    Raises:
        ValueError: a request that makes no sense.
        Refused: a drape that the gate refuses, where it is asked.
    """
    check(session, request, treatment)
    fabric = request.fabric or session.fabrics[0]
    with clock.stage("body"):
        betas, remarks = resolve_betas(session.body, request.shape, session.num_betas)
    design = None if request.mesh is not None else resolve_design(session.space, request.cut)
    garment = session.prepare(
        design,
        mesh=request.mesh,
        own=treatment.own,
        seed=treatment.seed,
        stopwatch=clock,
        progress=clock.progress("settling"),
    )
    if treatment.simulate:
        progress = clock.progress("dressing")
        dressed = session.simulate(garment, betas, fabric=fabric, stopwatch=clock, progress=progress)
    else:
        learned = fabric if fabric in session.fabrics else session.fabrics[0]
        dressed = session.drape(garment, betas, fabric=learned, stopwatch=clock)
        if treatment.gate:
            session.judge_body(dressed.body).check("this body")
    if treatment.refine:
        progress = clock.progress("refining")
        dressed = session.refine(dressed, treatment.steps, fabric=fabric, stopwatch=clock, progress=progress)
    if treatment.push_out:
        dressed = session.push_out(dressed, CLEARANCE, stopwatch=clock)
    dressed = session.judge(dressed, stopwatch=clock)
    if treatment.gate and dressed.verdict is not None:
        dressed.verdict.check(garment.label)
    if pose is not None:
        dressed = session.pose(dressed, pose, stopwatch=clock)
    return dressed, remarks
