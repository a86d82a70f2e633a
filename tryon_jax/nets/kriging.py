"""Drapes of all designs as a Gaussian process of design and body shape, at the nodes of the template.

The process has one squared-exponential kernel for all coordinates and a trend that is linear in the body's shape and
in the design (Rasmussen and Williams 2006, section 2.7). In place of a weight for each of some thousand training drapes
it keeps weights of the trend's functions and of the kernel's own leading eigenfunctions, which are products of Hermite
functions (section 4.3.1). A prediction is therefore smooth in design and body shape, and where no drape is near, as of
tight garments on large bodies, the trend alone lets the cloth follow the body. For one design it is a sum of fields
whose weights depend on the body's shape alone.
"""

import functools
import math
from dataclasses import dataclass
from itertools import product

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tryon_jax.types import EXACT, ArrayLike, pytree, static


@dataclass(frozen=True)
class KrigingConfig:
    """Kernel of the process, a squared exponential over designs and body shapes, and the size of its basis."""

    design: float = 0.7
    """Length, in half ranges of the parameters."""
    shape: float = 0.7
    """Length, in half axes of what the dataset covers."""
    nugget: float = 0.01
    """Variance that no neighbour shares, over the variance that all share."""
    degree: int = 8
    """Largest degree of an eigenfunction, over designs and body shapes together."""
    shape_degree: int = 6
    """Largest degree in the body shape alone."""
    spread: float = 0.6
    """Standard deviation of the measure under which they are eigenfunctions, in half ranges."""
    components: int = 160
    """Principal components of the drapes."""
    nodes: int = 1574
    """Nodes of the template: its vertices and the middles of its edges."""


@pytree
class ShapeFunctions:
    """Functions of the betas that weight the fields of one design: the kernel's, a constant, and the betas."""

    shape_scale: Float[ArrayLike, " b"]
    """Half axes of what the dataset covers, standard deviations."""
    config: KrigingConfig = static(default=KrigingConfig())


@pytree
class Kriging:
    """Displacement from the mean drape of any design on any body shape, in one fabric."""

    edges: Int[ArrayLike, "E 2"]
    """Edges of the template, sorted; nodes are its T vertices, then the middles of these."""
    mean: Float[ArrayLike, "Q 3"]
    """Mean displacement of the training drapes at each node, metres."""
    components: Float[ArrayLike, "R Q 3"]
    """Principal components of their displacements, each as large as one standard deviation of it, metres."""
    weights: Float[ArrayLike, "F R"]
    """Of each function, the kernel's first, in each component's coordinate, standard deviations."""
    design_center: Float[ArrayLike, " P"]
    design_scale: Float[ArrayLike, " P"]
    """The kernel sees (design − center) / scale: half ranges of the design space."""
    shapes: ShapeFunctions

    @property
    def num_vertices(self) -> int:
        """Vertices of the template."""
        return jnp.shape(self.mean)[0] - jnp.shape(self.edges)[0]


def empty_kriging(config: KrigingConfig, template_vertices: int, parameters: int, betas: int) -> Kriging:
    """A process that moves nothing.

    Args:
        config: Its sizes.
        template_vertices: T.
        parameters: Of a design.
        betas: Of a body.
    """
    functions = len(function_pairs(config, parameters, betas)[0])
    return Kriging(
        jnp.zeros((config.nodes - template_vertices, 2), jnp.int32),
        jnp.zeros((config.nodes, 3)),
        jnp.zeros((config.components, config.nodes, 3)),
        jnp.zeros((functions, config.components)),
        jnp.zeros(parameters),
        jnp.ones(parameters),
        ShapeFunctions(jnp.ones(betas), config),
    )


def kriged_fields(
    kriging: Kriging,
    design: Float[Array, " P"],
    template_vertices: Int[Array, "N 3"],
    template_weights: Float[Array, "N 3"],
) -> Float[Array, "N 3 K"]:
    """The displacement fields of one design at the vertices of a mesh; `apply_shape_functions` weights them.

    Args:
        kriging: From `KrigingFit`.
        design: Parameters, metres.
        template_vertices: Vertices of the template triangle in which each vertex lies.
        template_weights: Its barycentric weights there; zeros for padding.

    Returns:
        Fields, metres; the mean displacement is in that of the constant.
    """
    config, betas = kriging.shapes.config, jnp.shape(kriging.shapes.shape_scale)[0]
    scaled = (design - jnp.asarray(kriging.design_center)) / jnp.asarray(kriging.design_scale)
    of_design, of_shape = function_pairs(config, len(scaled), betas)
    values = _with_trend(scaled[None], config.design, config.spread, config.degree)[0]
    weighted = values[of_design][:, None] * jnp.asarray(kriging.weights)
    kernel_functions = len(exponents(betas, config.shape_degree))
    count = kernel_functions + 1 + betas
    coordinates = jnp.zeros((count, weighted.shape[1]), weighted.dtype).at[of_shape].add(weighted)
    at_nodes = jnp.einsum("kr,rqc->qck", coordinates, jnp.asarray(kriging.components), precision=EXACT)
    at_nodes = at_nodes.at[..., kernel_functions].add(jnp.asarray(kriging.mean))
    nodes, shares = quadratic_element(kriging.edges, kriging.num_vertices, template_vertices, template_weights)
    return jnp.einsum("vn,vnck->vck", shares, at_nodes[nodes], precision=EXACT)


def apply_shape_functions(functions: ShapeFunctions, betas: Float[Array, "B b"]) -> Float[Array, "B K"]:
    """Weights of a design's fields for bodies of shape `betas`.

    Args:
        functions: Of the process.
        betas: Standard deviations.
    """
    config = functions.config
    return _with_trend(
        betas / jnp.asarray(functions.shape_scale)[None], config.shape, config.spread, config.shape_degree
    )


def joint_functions(
    designs: Float[Array, "S P"], shapes: Float[Array, "S b"], config: KrigingConfig
) -> Float[Array, "S F"]:
    """All functions of the process at pairs of a design and a body shape; `Kriging.weights` are theirs.

    Args:
        designs: In half ranges of the parameters, about their middle.
        shapes: In half axes of what the dataset covers.
        config: Of the process.
    """
    of_design, of_shape = function_pairs(config, designs.shape[1], shapes.shape[1])
    one = _with_trend(designs, config.design, config.spread, config.degree)
    other = _with_trend(shapes, config.shape, config.spread, config.shape_degree)
    return one[:, of_design] * other[:, of_shape]


def _with_trend(points: Float[Array, "S d"], length: float, spread: float, degree: int) -> Float[Array, "S F"]:
    """The kernel's functions, a constant, and the coordinates."""
    kernel = eigenfunctions(points, length, spread, exponents(points.shape[1], degree))
    return jnp.concatenate([kernel, jnp.ones_like(points[:, :1]), points], axis=1)


def eigenfunctions(
    points: Float[Array, "S d"], length: float, spread: float, degrees: Int[np.ndarray, "F d"]
) -> Float[Array, "S F"]:
    """Leading eigenfunctions of a squared exponential, each times the root of its eigenvalue, at points.

    Their products at two points add up to the kernel there, but for the degrees that are left out.

    Args:
        points: Where to evaluate.
        length: Of the kernel.
        spread: Standard deviation of the normal measure under which they are orthogonal.
        degrees: In each dimension, of each function.
    """
    a, b = 1 / (4 * spread**2), 1 / (2 * length**2)
    c = math.sqrt(a * a + 2 * a * b)
    ratio = b / (a + b + c)
    x = math.sqrt(2 * c) * points
    first = (c / a) ** 0.25 * (2 * a / (a + b + c)) ** 0.25 * jnp.exp(-(c - a) * points * points)
    # Hermite polynomials over the roots of 2^k k!, by their three-term recurrence.
    tables = [first, math.sqrt(2 * ratio) * x * first]
    for k in range(2, int(degrees.max()) + 1):
        tables.append(math.sqrt(2 * ratio / k) * x * tables[-1] - ratio * math.sqrt((k - 1) / k) * tables[-2])
    table = jnp.stack(tables)
    return functools.reduce(jnp.multiply, [table[row, :, i] for i, row in enumerate(degrees.T)]).T


def exponents(dimensions: int, degree: int) -> Int[np.ndarray, "F d"]:
    """Degrees in each dimension of all functions whose total degree is at most `degree`."""
    every = [row for row in product(range(degree + 1), repeat=dimensions) if sum(row) <= degree]
    return np.array(every, np.int32)


def function_pairs(
    config: KrigingConfig, parameters: int, betas: int
) -> tuple[Int[np.ndarray, " F"], Int[np.ndarray, " F"]]:
    """Which function of the design and which of the body shape make up each function of the process.

    First the kernel's, up to a total degree, then those of the trend: products of a constant or a parameter and a
    constant or a beta.

    Args:
        config: Of the process.
        parameters: Of a design.
        betas: Of a body.
    """
    designs, shapes = exponents(parameters, config.degree), exponents(betas, config.shape_degree)
    total = designs.sum(axis=1)[:, None] + shapes.sum(axis=1)[None]
    first, second = np.nonzero(total <= config.degree)
    trend = np.indices((parameters + 1, betas + 1)).reshape(2, -1)
    of_design = np.concatenate([first, len(designs) + trend[0]])
    return of_design.astype(np.int32), np.concatenate([second, len(shapes) + trend[1]]).astype(np.int32)


def quadratic_element(
    edges: Int[ArrayLike, "E 2"],
    num_vertices: int,
    corners: Int[Array, "N 3"],
    weights: Float[Array, "N 3"],
) -> tuple[Int[Array, "N 6"], Float[Array, "N 6"]]:
    """Nodes of the quadratic triangle in which points lie, and their shape functions there.

    Args:
        edges: Of the template, sorted.
        num_vertices: Of the template; the middle of edge k is node `num_vertices` + k.
        corners: Vertices of each point's triangle; the three are the same for a point on a vertex.
        weights: Barycentric.

    Returns:
        Six nodes of each point and their weights, which sum to 1 where the barycentric ones do.
    """
    pairs, known = corners[:, np.array([[0, 1], [1, 2], [2, 0]])], jnp.asarray(edges)
    keys = known[:, 0] * num_vertices + known[:, 1]
    wanted = pairs.min(axis=-1) * num_vertices + pairs.max(axis=-1)
    found = jnp.minimum(jnp.searchsorted(keys, wanted), len(keys) - 1)
    across = 4.0 * weights * jnp.roll(weights, -1, axis=1)
    # On an edge given twice, or of a point that lies on a vertex, nothing is across.
    across = jnp.where(keys[found] == wanted, across, 0.0)
    own = weights * (2.0 * weights - 1.0)
    return jnp.concatenate([corners, num_vertices + found], axis=1), jnp.concatenate([own, across], axis=1)
