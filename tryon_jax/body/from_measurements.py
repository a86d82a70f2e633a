"""The shape of a body from a few measurements."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.body.landmarks import Landmarks, load_landmarks
from tryon_jax.body.measurements import MEASUREMENTS, check_measurement, measure_vertices
from tryon_jax.body.shape import shape_body
from tryon_jax.types import Body

_TOLERANCE = 0.001
# A deviation of one millimetre weighs as much as a body one standard deviation away from the mean.
_PRIOR = 0.3
_LIMIT = 3.0
# Standard deviations: bodies further from the mean are unrealistic.
_WALL = 300.0
REACHED = 0.005
"""Residual in metres below which a measurement counts as met."""


@dataclass(frozen=True)
class MeasurementFit:
    """The body that comes closest to the measurements asked for."""

    betas: Float[Array, " B"]
    """Its shape, standard deviations."""
    asked: dict[str, float]
    """What was asked for, metres."""
    measured: dict[str, float]
    """All measurements of this body, metres."""
    residuals: dict[str, float]
    """Measured minus asked, metres, for each measurement asked for."""
    outside: str | None
    """None when every residual is below 5 mm; otherwise what the body cannot be, in words."""


def _outside(body: Body, asked: Mapping[str, float], residuals: Mapping[str, float], betas: np.ndarray) -> str | None:
    missed = [name for name, residual in residuals.items() if abs(residual) > REACHED]
    if not missed:
        return None
    worst = ", ".join(f"{name} {asked[name]:.3f} m missed by {1e3 * residuals[name]:+.0f} mm" for name in missed)
    edge = " at the edge of its range" if np.abs(betas).max() > _LIMIT - 0.1 else ""
    return f"body {body.name!r} cannot have these measurements together: {worst} (the nearest body{edge} is returned)"


def betas_from_measurements(
    body: Body,
    measurements: Mapping[str, float],
    landmarks: Landmarks | None = None,
    num_betas: int | None = None,
) -> MeasurementFit:
    """The likeliest shape of a body with these measurements.

    Levenberg-Marquardt on the differences in millimetres with a weak prior that draws each beta to the mean and a
    steep one beyond three standard deviations: what the measurements leave open stays average. Host side.

    Measurements that the body cannot have together do not raise: the nearest body comes back and `outside` says so.

    Args:
        body: The body.
        measurements: Metres, by names of `MEASUREMENTS`.
        landmarks: Of the body; found on it when None.
        num_betas: Search shapes of the first so many betas alone; all when None.

    Raises:
        ValueError: No measurement, an unknown name, or a value that is no adult's (also for centimetres).
    """
    if num_betas is not None:
        body = replace(body, shapedirs=body.shapedirs[..., :num_betas])
    asked = {name: check_measurement(name, value) for name, value in measurements.items()}
    if not asked:
        raise ValueError("give at least one measurement, such as {'stature': 1.72}")
    landmarks = jax.tree.map(jnp.asarray, load_landmarks(body) if landmarks is None else landmarks)
    # The solver's own numbers have JAX's default precision; the result has the body's.
    dtype = jnp.result_type(float)
    # A target and a weight for every measurement, so that any choice of them runs the same compiled program.
    targets = jnp.asarray([asked.get(name, 1.0) for name in MEASUREMENTS], dtype)
    weights = jnp.asarray([float(name in asked) for name in MEASUREMENTS], dtype) / _TOLERANCE
    betas = _solve(body, landmarks, targets, weights).astype(jnp.asarray(body.v_template).dtype)
    measured = dict(zip(MEASUREMENTS, _measure(body, landmarks, betas), strict=True))
    measured = {name: float(value) for name, value in measured.items()}
    residuals = {name: measured[name] - value for name, value in asked.items()}
    return MeasurementFit(betas, asked, measured, residuals, _outside(body, asked, residuals, np.asarray(betas)))


@jax.jit
def _measure(body: Body, landmarks: Landmarks, betas: Float[Array, " B"]) -> Float[Array, " M"]:
    measured = measure_vertices(shape_body(body, betas)[0], landmarks)
    return jnp.stack([measured[name] for name in MEASUREMENTS])


@jax.jit
def _solve(
    body: Body, landmarks: Landmarks, targets: Float[Array, " M"], weights: Float[Array, " M"]
) -> Float[Array, " B"]:
    def residuals(betas: Float[Array, " B"], _: None) -> Float[Array, " R"]:
        misses = weights * (_measure(body, landmarks, betas) - targets)
        beyond = jnp.maximum(jnp.abs(betas) - _LIMIT, 0)
        return jnp.concatenate([misses, _PRIOR * betas, _WALL * beyond])

    # Imported where it is needed: it takes half a second to load, and most programs ask for no measurements.
    import optimistix as optx

    solver = optx.LevenbergMarquardt(rtol=1e-3, atol=1e-3)
    start = jnp.zeros(body.num_betas, targets.dtype)
    return optx.least_squares(residuals, solver, start, max_steps=200, throw=False).value
