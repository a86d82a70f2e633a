"""Unknowns of inverse problems in units of their own, and the solver that finds them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.garment import DesignSpace
from tryon_jax.types import ArrayLike, pytree

_WALL = 100.0
"""Millimetres that one unit beyond the range costs."""


@pytree
class Unknowns:
    """Design parameters in half ranges from their middle and betas as they are, in one vector."""

    center: Float[ArrayLike, " U"]
    scale: Float[ArrayLike, " U"]
    limit: Float[ArrayLike, " U"]
    """Largest absolute value of each unknown."""

    @classmethod
    def of(cls, space: DesignSpace, extent: Sequence[float] = ()) -> "Unknowns":
        """Unknowns of a design space, and as many betas as `extent` has largest values; the body is known without."""
        middle, half, num_betas = space.middle, 0.5 * (space.maximum - space.minimum), len(extent)
        return cls(
            np.concatenate([middle, np.zeros(num_betas)]).astype(np.float32),
            np.concatenate([half, np.ones(num_betas)]).astype(np.float32),
            np.concatenate([np.ones(len(half)), np.asarray(extent, float)]).astype(np.float32),
        )

    def values(self, units: Float[ArrayLike, " U"]) -> Float[Array, " U"]:
        """Design in metres, then betas."""
        return jnp.asarray(self.center) + self.scale * jnp.asarray(units)

    def units(self, values: Float[np.ndarray, " U"]) -> Float[np.ndarray, " U"]:
        """The inverse of `values`."""
        return ((values - np.asarray(self.center)) / np.asarray(self.scale)).astype(np.float32)

    def beyond(self, units: Float[Array, " U"]) -> Float[Array, " U"]:
        """Residuals, millimetres, that keep unknowns within their range."""
        return _WALL * jnp.maximum(jnp.abs(units) - self.limit, 0.0)


@dataclass(frozen=True, eq=False)
class Found:
    """Where a solver ended."""

    units: Float[np.ndarray, " U"]
    steps: int
    residual: float
    """Root of the mean square of its residuals, millimetres."""
    rounds: list[float] = field(default_factory=list)


def solve(
    residuals: Callable[..., Float[Array, " R"]], start: Float[np.ndarray, " U"], args: object, most: int
) -> Found:
    """Levenberg-Marquardt on residuals in millimetres.

    Args:
        residuals: Of units and `args`; the same object in every call, to compile once.
        start: Units to start from.
        args: Passed on to `residuals`.
        most: Steps at most.
    """
    units, steps, size = _solve(residuals, jnp.asarray(start, jnp.float32), args, most)
    return Found(np.asarray(units), int(steps), float(size))


def _minimise(residuals: Callable[..., Array], start: Array, args: object, most: int) -> tuple[Array, Array, Array]:
    # Imported where it is needed: it takes half a second to load, and most programs solve for nothing.
    import optimistix as optx

    solver = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-3)
    # Not as its `args`, whose leaves it replaces by others for a while: no shape would be right then.
    solution = optx.least_squares(lambda units, _: residuals(units, args), solver, start, max_steps=most, throw=False)
    final = residuals(solution.value, args)
    return solution.value, solution.stats["num_steps"], jnp.sqrt((final * final).mean())


_solve = jax.jit(_minimise, static_argnums=(0, 3))
