"""What kriging's functions need beside what files keep: the factor that follows from their centres (host side)."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import scipy.linalg

from tryon_jax.nets.kriging import KernelFunctions, Kriging, matern

_JITTER = 1e-6


def with_factor(functions: KernelFunctions) -> KernelFunctions:
    """The functions with their factor."""
    centres = np.asarray(functions.centres, np.float64)
    kernel = matern(centres, centres, functions.length, np) + _JITTER * np.eye(len(centres))
    factor = scipy.linalg.solve_triangular(np.linalg.cholesky(kernel), np.eye(len(centres)), lower=True)
    return replace(functions, factor=jnp.asarray(factor, jnp.float32))


def with_factors(kriging: Kriging) -> Kriging:
    """A process from a file, complete."""
    shapes = replace(kriging.shapes, kernel=with_factor(kriging.shapes.kernel))
    return replace(kriging, designs=with_factor(kriging.designs), shapes=shapes)


def without_factors(kriging: Kriging) -> Kriging:
    """A process as files keep it: without what follows from the rest."""
    shapes = replace(kriging.shapes, kernel=replace(kriging.shapes.kernel, factor=None))
    return replace(kriging, designs=replace(kriging.designs, factor=None), shapes=shapes)
