"""Which functions of a kernel a kriged process keeps: centres spread over what is fitted, and the largest products."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.stats import qmc

from tryon_jax.checks import check_range
from tryon_jax.nets.kernel_factor import with_factor
from tryon_jax.nets.kriging import KernelFunctions, KrigingConfig, functions_and_trend, joint_functions
from tryon_jax.training.node_drapes import NodeDrapes

_functions_and_trend, _joint_functions = jax.jit(functions_and_trend), jax.jit(joint_functions)


@dataclass(frozen=True, eq=False)
class ChosenFunctions:
    """The functions of a process."""

    designs: KernelFunctions
    shapes: KernelFunctions
    pairs: tuple[Int[np.ndarray, " F"], Int[np.ndarray, " F"]]
    """Which function of the design and which of the body shape make up each product; those of the trend are last."""

    def __call__(self, drapes: NodeDrapes) -> Float[np.ndarray, "S F"]:
        """Their values for some drapes.

        Args:
            drapes: Designs and body shapes.
        """
        one = _functions_and_trend(self.designs, jnp.asarray(drapes.designs))
        other = _functions_and_trend(self.shapes, jnp.asarray(drapes.shapes))
        return np.asarray(_joint_functions(one, other, self.pairs), np.float64)


def choose_functions(drapes: NodeDrapes, config: KrigingConfig) -> ChosenFunctions:
    """Centres among the drapes' designs and body shapes, and the products whose variance is largest.

    Args:
        drapes: What is to be fitted.
        config: Lengths and numbers.

    Raises:
        ValueError: more products are asked for than there are.
    """
    check_range("functions of the process", config.functions, 1, config.designs * config.shapes)
    kernels = [
        with_factor(KernelFunctions(jnp.asarray(spread_points(points, count)), None, length))
        for points, count, length in (
            (drapes.designs, config.designs, config.design),
            (drapes.shapes, config.shapes, config.shape),
        )
    ]
    designs, shapes = kernels
    # The variance of a function is what those before it leave at its centre: the square of the factor's diagonal.
    variances = [1.0 / np.diag(np.asarray(kernel.factor, np.float64)) ** 2 for kernel in kernels]
    products = variances[0][:, None] * variances[1][None]
    largest = np.sort(np.argsort(-products.ravel(), kind="stable")[: config.functions])
    first, second = np.unravel_index(largest, products.shape)
    trend = np.indices((drapes.designs.shape[1] + 1, drapes.shapes.shape[1] + 1)).reshape(2, -1)
    of_design, of_shape = (
        np.concatenate([index, size + row]).astype(np.int32)
        for index, size, row in zip((first, second), (config.designs, config.shapes), trend, strict=True)
    )
    return ChosenFunctions(designs, shapes, (of_design, of_shape))


def spread_points(points: Float[np.ndarray, "N d"], count: int) -> Float[np.ndarray, "M d"]:
    """Points of a set each of which is the farthest from those before it; the first is the nearest to the origin.

    Where there are too few different ones, points of a Sobol sequence in the cube from -1 to 1 follow.

    Args:
        points: The set.
        count: Points M.
    """
    different = np.unique(np.asarray(points, np.float32), axis=0)
    if len(different) < count:
        sobol = qmc.Sobol(points.shape[1], scramble=False).random(1 << int(np.ceil(np.log2(2 * count + 2))))
        more = (2.0 * sobol - 1.0).astype(np.float32)
        own = _farthest(different, len(different))
        rest = more[np.linalg.norm(more[:, None] - different[None], axis=2).min(axis=1) > 0]
        return np.concatenate([own, _farthest(rest, count - len(own))])
    return _farthest(different, count)


def _farthest(points: np.ndarray, count: int) -> np.ndarray:
    chosen = [int(np.linalg.norm(points, axis=1).argmin())]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]
