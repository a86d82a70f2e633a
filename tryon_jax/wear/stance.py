"""A dressed body that lowers its arms: no longer a T-pose, and folds that come with it."""

from dataclasses import replace

import jax
import numpy as np

from tryon_jax.body.pose import pose_body
from tryon_jax.body.stance import arms_pose
from tryon_jax.contact.push_out import EXACT_BELOW
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.session import Session
from tryon_jax.wear.simulate import StanceProgress
from tryon_jax.wear.stopwatch import Stopwatch

_pose_body = jax.jit(pose_body)


def lower_arms(
    session: Session,
    dressed: DressedBody,
    degrees: float,
    *,
    simulate: bool | None = None,
    outside: bool = True,
    stopwatch: Stopwatch | None = None,
    progress: StanceProgress | None = None,
) -> DressedBody:
    """The same body and garment with the arms down.

    The learned drape stands in T-pose. R_stance adds what lowered arms change in it, and the cloth is skinned along: a
    few milliseconds. By simulation the arms come down in small steps, and the cloth is brought to rest after each, in
    contact with the body and with itself: a few seconds. The fit stays that of the T-pose: bodies are measured there.

    Args:
        session: What dressed the body.
        dressed: In T-pose: from `drape`, `refine`, `push_out` or `judge`.
        degrees: Of the arms below the horizontal, 0 to `body.stance.LOWEST`.
        simulate: By simulation; by default where the drape itself is simulated, or the model has no R_stance.
        outside: Push what is left inside the body out of it.
        stopwatch: Takes the time of "arms".
        progress: Told after each stance of a simulation.

    Returns:
        With its verdict.

    Raises:
        ValueError: An angle out of range, arms that are down already, or another body than the networks'.
        NotSettled: The cloth finds no rest there.
        Diverged: The simulation diverged.
    """
    if session.other is not None:
        raise ValueError("arms are lowered on the networks' body; another body stays in T-pose")
    if dressed.arms:
        raise ValueError(f"the arms are {dressed.arms:g} degrees below the horizontal already: start from the T-pose")
    pose = arms_pose(session.body, degrees).astype(np.float32)
    if simulate is None:
        simulate = dressed.simulated is not None or session.model.stance is None
    watch, result = stopwatch or Stopwatch(), None
    with watch.stage("arms"):
        if simulate:
            result = session.simulator.lower_arms(
                dressed.vertices,
                dressed.garment.pattern,
                load_fabric(dressed.fabric),
                dressed.body.betas,
                session.skinning(dressed.garment),
                degrees,
                progress,
            )
            vertices = result.vertices
            skin = np.asarray(_pose_body(session.body, np.asarray(dressed.body.betas, np.float32), pose)[0])
        else:
            vertices, skin = session.stand(dressed, degrees)
    standing = replace(
        dressed,
        body=replace(dressed.body, vertices=skin),
        vertices=vertices,
        simulated=result,
        pushed=None,
        verdict=None,
        arms=degrees,
    )
    if outside:
        standing = replace(session.push_out(standing, stopwatch=watch), fit=dressed.fit)
    with watch.stage("gate"):
        if standing.pushed is not None:
            clearance = standing.pushed.distance
        else:
            clearance = standing.body.surface.closest(standing.vertices.astype(np.float64), EXACT_BELOW).distance
        return replace(standing, verdict=session.verdict(standing, clearance))
