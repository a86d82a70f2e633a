"""Drapes of all designs as a Gaussian process of design and body shape, at the nodes of the template.

The process has one kernel for all coordinates, a product of a Matérn kernel over designs and one over body shapes, and
a trend that is linear in both (Rasmussen and Williams 2006, sections 2.7 and 4.2). In place of a weight for each of
some thousand training drapes it keeps weights of the trend's functions and of products of the kernels' functions at a
few hundred designs and some body shapes. Where no drape is near, as of tight garments on large bodies, the trend alone
lets the cloth follow the body. For one design the process is a sum of fields whose weights depend on the body's shape
alone.
"""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tryon_jax.types import EXACT, ArrayLike, pytree, static

_TINY = 1e-12


@dataclass(frozen=True)
class KrigingConfig:
    """Kernel of the process, a product of a Matérn 3/2 over designs and one over body shapes, and its basis."""

    design: float = 1.0
    """Length, in half ranges of the parameters."""
    shape: float = 1.0
    """Length, in half axes of what the dataset covers."""
    nugget: float = 0.02
    """Variance that no neighbour shares, over the variance that all share."""
    designs: int = 600
    """Designs at which the kernel's functions have their centres."""
    shapes: int = 48
    """Body shapes at which they have."""
    functions: int = 4500
    """Products of a function of the design and one of the body shape that are kept."""
    components: int = 192
    """Principal components of the drapes."""
    nodes: int = 1574
    """Nodes of the template: its vertices and the middles of its edges."""


@pytree
class KernelFunctions:
    """Functions of a kernel, in an order: each is what the kernel at its centre has beyond the functions before it.

    Their products at two points add up to the kernel there as far as the centres know it (the Newton basis; Müller and
    Schaback, *A Newton basis for kernel spaces*, 2009).
    """

    centres: Float[ArrayLike, "M d"]
    factor: Float[ArrayLike, "M M"] | None
    """Inverse of the Cholesky factor of the kernel between the centres; None in files, which do not keep it."""
    length: float = static(default=1.0)
    """Of the kernel."""


@pytree
class ShapeFunctions:
    """Functions of the betas that weight the fields of one design: the kernel's, a constant, and the betas."""

    shape_scale: Float[ArrayLike, " b"]
    """Half axes of what the dataset covers, standard deviations."""
    kernel: KernelFunctions


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
    """Of each function, those of the trend last, in each component's coordinate, standard deviations."""
    design_center: Float[ArrayLike, " P"]
    design_scale: Float[ArrayLike, " P"]
    """The kernel sees (design − center) / scale: half ranges of the design space."""
    designs: KernelFunctions
    of_design: Int[ArrayLike, " F"]
    """Which function of the design is in each product."""
    of_shape: Int[ArrayLike, " F"]
    """Which function of the body shape."""
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

    def kernel(count: int, dimensions: int, length: float) -> KernelFunctions:
        return KernelFunctions(jnp.zeros((count, dimensions)), jnp.zeros((count, count)), length)

    functions = config.functions + (1 + parameters) * (1 + betas)
    return Kriging(
        jnp.zeros((config.nodes - template_vertices, 2), jnp.int32),
        jnp.zeros((config.nodes, 3)),
        jnp.zeros((config.components, config.nodes, 3)),
        jnp.zeros((functions, config.components)),
        jnp.zeros(parameters),
        jnp.ones(parameters),
        kernel(config.designs, parameters, config.design),
        jnp.zeros(functions, jnp.int32),
        jnp.zeros(functions, jnp.int32),
        ShapeFunctions(jnp.ones(betas), kernel(config.shapes, betas, config.shape)),
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
        template_vertices: Corners of the template's triangle in which each vertex lies; any for padding.
        template_weights: Its barycentric weights there; zeros for padding.

    Returns:
        Fields, metres; the mean displacement is in that of the constant.
    """
    kernel_functions, betas = jnp.shape(kriging.shapes.kernel.centres)
    scaled = (design - jnp.asarray(kriging.design_center)) / jnp.asarray(kriging.design_scale)
    values = functions_and_trend(kriging.designs, scaled[None])[0]
    weighted = values[jnp.asarray(kriging.of_design)][:, None] * jnp.asarray(kriging.weights)
    count = kernel_functions + 1 + betas
    coordinates = jnp.zeros((count, weighted.shape[1]), weighted.dtype).at[jnp.asarray(kriging.of_shape)].add(weighted)
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
    return functions_and_trend(functions.kernel, betas / jnp.asarray(functions.shape_scale)[None])


def joint_functions(
    of_designs: Float[Array, "S A"],
    of_shapes: Float[Array, "S K"],
    pairs: tuple[Int[ArrayLike, " F"], Int[ArrayLike, " F"]],
) -> Float[Array, "S F"]:
    """All functions of the process at pairs of a design and a body shape; `Kriging.weights` are theirs.

    Args:
        of_designs: Functions of the designs, from `functions_and_trend`.
        of_shapes: Functions of the body shapes.
        pairs: Which of either is in each product.
    """
    first, second = (jnp.asarray(index) for index in pairs)
    return of_designs[:, first] * of_shapes[:, second]


def functions_and_trend(functions: KernelFunctions, points: Float[Array, "S d"]) -> Float[Array, "S F"]:
    """The kernel's functions, a constant, and the coordinates: along these tight garments still follow large bodies.

    Args:
        functions: Of the kernel, with their factor.
        points: In units of the kernel's length scale before it.
    """
    assert functions.factor is not None, "these functions are as a file keeps them: `with_factor` completes them"
    at_centres = matern(points, jnp.asarray(functions.centres), functions.length, jnp)
    values = jnp.einsum("sm,fm->sf", at_centres, jnp.asarray(functions.factor), precision=EXACT)
    return jnp.concatenate([values, jnp.ones_like(points[:, :1]), points], axis=1)


def matern(points: Any, others: Any, length: float, xp: Any) -> Any:
    """The Matérn kernel of smoothness 3/2 between points [S, d] and others [M, d], of unit variance.

    Source: Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2006, equation 4.17.

    Args:
        points: Coordinates.
        others: Coordinates.
        length: In which the kernel falls to a half or so.
        xp: `numpy` or `jax.numpy`.
    """
    squared = ((points[:, None] - others[None]) ** 2).sum(axis=-1)
    # Its derivative vanishes where the points meet; that of a distance is not defined there.
    far = xp.sqrt(3.0 * squared + _TINY) / length
    return (1.0 + far) * xp.exp(-far)


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
