"""Requests answered by a session: what is done to a drape, in which order, and when it is refused."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from tryon_jax.body.measurements import check_measurement
from tryon_jax.checks import check_file
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._request import Request, check_shape, resolve_betas, resolve_design
from tryon_jax.contact.push_out import CLEARANCE
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.gate import judge_betas
from tryon_jax.wear.own import OwnOptions
from tryon_jax.wear.prepared import PreparedGarment
from tryon_jax.wear.session import Session
from tryon_jax.wear.stance import lower_arms

FAILURES = (ValueError, TypeError, OSError, FloatingPointError)
"""What goes wrong with one request and says nothing of the others."""


PICTURE_ARMS = 45.0
"""Degrees below the horizontal that arms have in pictures where nothing is said: nobody stands in a T-pose."""


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
    arms: float | None = None
    """Degrees by which the arms are lowered; None: only in the picture of a learned drape, by `PICTURE_ARMS`."""
    own: OwnOptions = field(default_factory=OwnOptions)
    seed: int = 0

    @property
    def simulates(self) -> bool:
        """Whether the simulator takes part."""
        return self.simulate or self.refine

    def check_fabric(self, session: Session, fabric: str | None) -> None:
        """Raise `ValueError` for a fabric that neither the networks nor, where it takes part, the simulator knows."""
        if fabric is not None and self.simulates:
            load_fabric(fabric)
        else:
            session.check_fabric(fabric)


def check(session: Session, request: Request, treatment: Treatment) -> None:
    """Raise for a request that cannot be answered, as far as that can be told without draping.

    Raises:
        ValueError: an unknown fabric or design, numbers out of range, or betas far from what the networks know.
        FileNotFoundError: there is no such mesh.
    """
    treatment.check_fabric(session, request.fabric)
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


@dataclass(frozen=True, eq=False)
class Draped:
    """A request's drape, before anything is done to it."""

    dressed: DressedBody
    remarks: list[str]
    """What there is to say about the body's shape."""


def answer(
    session: Session,
    request: Request,
    treatment: Treatment,
    clock: Clock,
    pose: Float[np.ndarray, "J 3"] | None = None,
    draped: Draped | None = None,
) -> tuple[DressedBody, list[str]]:
    """The dressed body of one request, and what there is to say about its shape.

    Args:
        session: What drapes.
        request: Garment, body and fabric.
        treatment: What is done to the drape.
        clock: Takes the time.
        pose: To be put on at the end.
        draped: The drape, where `drape_together` has made it already.

    Raises:
        ValueError: a request that makes no sense.
        Refused: a drape that the gate refuses, where it is asked.
    """
    check(session, request, treatment)
    fabric = request.fabric or session.fabrics[0]
    if draped is None:
        draped = _drape(session, request, treatment, clock)
    dressed = draped.dressed
    if treatment.gate and not treatment.simulate:
        session.judge_body(dressed.body).check("this body")
    if treatment.refine:
        progress = clock.progress("refining")
        dressed = session.refine(dressed, treatment.steps, fabric=fabric, stopwatch=clock, progress=progress)
    if treatment.push_out:
        dressed = session.push_out(dressed, CLEARANCE, stopwatch=clock)
    dressed = session.judge(dressed, stopwatch=clock)
    if treatment.gate and dressed.verdict is not None:
        dressed.verdict.check(dressed.garment.label)
    if treatment.arms:
        progress = clock.stances("lowering the arms")
        dressed = lower_arms(
            session, dressed, treatment.arms, outside=treatment.push_out, stopwatch=clock, progress=progress
        )
        if treatment.gate and dressed.verdict is not None:
            dressed.verdict.check(dressed.garment.label)
    if pose is not None:
        dressed = session.pose(dressed, pose, stopwatch=clock)
    return dressed, draped.remarks


def pictured(
    session: Session,
    dressed: DressedBody,
    treatment: Treatment,
    clock: Clock,
    pose: Float[np.ndarray, "J 3"] | None = None,
) -> DressedBody:
    """What a picture shows: a learned drape with the arms down, where neither stance nor pose was asked for.

    Args:
        session: What drapes.
        dressed: From `answer`.
        treatment: As there.
        clock: Takes the time.
        pose: As there.
    """
    asked = treatment.arms is not None or pose is not None
    if asked or dressed.simulated is not None or session.model.stance is None or session.other is not None:
        return dressed
    standing = lower_arms(session, dressed, PICTURE_ARMS, outside=treatment.push_out, stopwatch=clock)
    torn = treatment.gate and standing.verdict is not None and standing.verdict.outcome == "refused"
    return dressed if torn else standing


def drape_together(
    session: Session, requests: Sequence[Request], treatment: Treatment, clock: Clock
) -> dict[str, Draped]:
    """Learned drapes by name: those of the first request's garment and fabric, made in one call.

    A request that cannot be draped is left out, to fail when it is answered by itself.

    Args:
        session: What drapes.
        requests: The first is draped, and those that ask for the same garment and fabric.
        treatment: As in `answer`.
        clock: Takes the time.
    """
    if treatment.simulate or not requests:
        return {}
    first = requests[0]
    shapes: dict[str, tuple[np.ndarray, list[str]]] = {}
    try:
        for request in requests:
            if _drape_key(session, request) == _drape_key(session, first):
                with suppress(*FAILURES), clock.stage("body"):
                    shapes[request.name] = resolve_betas(session.body, request.shape, session.num_betas)
        if not shapes:
            return {}
        garment = _garment(session, first, treatment, clock)
        betas = [betas for betas, _ in shapes.values()]
        drapes = session.drape_many(garment, betas, fabric=_learned(session, first), stopwatch=clock)
    except FAILURES:
        return {}
    return {
        name: Draped(dressed, remarks) for dressed, (name, (_, remarks)) in zip(drapes, shapes.items(), strict=True)
    }


def _drape(session: Session, request: Request, treatment: Treatment, clock: Clock) -> Draped:
    with clock.stage("body"):
        betas, remarks = resolve_betas(session.body, request.shape, session.num_betas)
    garment = _garment(session, request, treatment, clock)
    if treatment.simulate:
        fabric, progress = request.fabric or session.fabrics[0], clock.progress("dressing")
        dressed = session.simulate(garment, betas, fabric=fabric, stopwatch=clock, progress=progress)
    else:
        dressed = session.drape(garment, betas, fabric=_learned(session, request), stopwatch=clock)
    return Draped(dressed, remarks)


def _garment(session: Session, request: Request, treatment: Treatment, clock: Clock) -> PreparedGarment:
    design = None if request.mesh is not None else resolve_design(session.space, request.cut)
    return session.prepare(
        design,
        mesh=request.mesh,
        own=treatment.own,
        seed=treatment.seed,
        stopwatch=clock,
        progress=clock.progress("settling"),
    )


def _learned(session: Session, request: Request) -> str:
    """The fabric that the networks drape; another one is only refined."""
    return request.fabric if request.fabric and session.drapes_fabric(request.fabric) else session.fabrics[0]


def _drape_key(session: Session, request: Request) -> tuple[str, str, str]:
    """What requests must share to be draped together."""
    return str(request.mesh), repr(request.cut), _learned(session, request)
