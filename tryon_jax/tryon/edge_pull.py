"""Device side, pure: edges that networks stretch too far, pulled together on bodies of all shapes.

The few edges of a garment that are stretched on any of some bodies, as in an armpit, are found once for the garment.
Position-based dynamics (Müller et al. 2007) pulls their ends together there, as `mesh.stretch_limit` does on the host,
and how far each vertex moves is a polynomial of the body's shape from then on.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tryon_jax.body.shape_polynomial import ShapePolynomials, fit_polynomials
from tryon_jax.types import EXACT, ArrayLike, pytree

MOST = 1.3
"""Length over rest length that is left."""
_ROUNDS = 20
_SHARE = 8
"""One edge in so many is looked at, those that are stretched most; and one vertex in so many may move."""
_EDGES, _VERTICES = 1024, 512
"""At least so many."""


@pytree
class EdgePull:
    """How the P vertices of a garment that stretched edges pull on move with the body's shape."""

    vertices: Int[ArrayLike, "*batch P"]
    displacement: Float[ArrayLike, "*batch P 3 T"]
    """Coefficients of the polynomial of each, metres."""


def pull_together(
    drapes: Float[Array, "S N 3"], edges: Int[ArrayLike, "E 2"], rest: Float[ArrayLike, " E"]
) -> Float[Array, "S N 3"]:
    """Displacements that leave no edge longer than `MOST` times its rest length, or nearly so; metres.

    Derivatives take them for constants.

    Args:
        drapes: One for each body, metres.
        edges: Of the mesh.
        rest: Length of each at rest, metres.
    """
    drapes, lengths = jax.lax.stop_gradient((drapes, jnp.asarray(rest, drapes.dtype)))
    ends = jnp.asarray(edges)
    stretch = (_apart(drapes, ends[:, 0], ends[:, 1])[1] / lengths[None]).max(axis=0)
    _, chosen = jax.lax.top_k(stretch, min(len(ends), max(_EDGES, len(ends) // _SHARE)))
    first, second = ends[chosen, 0], ends[chosen, 1]
    allowed = MOST * lengths[chosen]

    def is_long(moved: Float[Array, "S N 3"]) -> tuple[Array, Array, Array]:
        apart, length = _apart(moved, first, second)
        return apart, length, length > 1.001 * allowed[None]

    def unfinished(state: tuple[Array, Float[Array, "S N 3"]]) -> Array:
        step, moved = state
        return (step < _ROUNDS) & is_long(moved)[2].any()

    def one_round(state: tuple[Array, Float[Array, "S N 3"]]) -> tuple[Array, Float[Array, "S N 3"]]:
        step, moved = state
        apart, length, long = is_long(moved)
        pull = jnp.where(long[..., None], 0.5 * (1.0 - allowed[None, :, None] / length[..., None]) * apart, 0.0)
        total = jnp.zeros_like(moved).at[:, first].add(pull).at[:, second].add(-pull)
        shared = jnp.zeros(moved.shape[:2], moved.dtype).at[:, first].add(long).at[:, second].add(long)
        return step + 1, moved + total / jnp.maximum(shared, 1.0)[..., None]

    _, moved = jax.lax.while_loop(unfinished, one_round, (jnp.asarray(0), drapes))
    return moved - drapes


def fit_pull(polynomials: ShapePolynomials, displacements: Float[Array, "M 3 S"]) -> EdgePull:
    """The displacements of the vertices that move farthest, as polynomials of the body's shape.

    Args:
        polynomials: Of the bodies.
        displacements: Of every vertex on each of them, metres.
    """
    farthest = (displacements * displacements).sum(axis=1).max(axis=1)
    count = len(farthest)
    _, vertices = jax.lax.top_k(farthest, min(count, max(_VERTICES, count // _SHARE)))
    chosen = jnp.moveaxis(displacements[vertices], 2, 0)
    return EdgePull(vertices, fit_polynomials(polynomials, chosen))


def apply_pull(pull: EdgePull, vertices: Float[Array, "B M 3"], terms: Float[Array, "B T"]) -> Float[Array, "B M 3"]:
    """Drapes with their stretched edges pulled together.

    Args:
        pull: Of the garment.
        vertices: Its drapes on some bodies, metres.
        terms: From `polynomial_terms` of these bodies.
    """
    moves = jnp.einsum("bt,pct->bpc", terms, jnp.asarray(pull.displacement), precision=EXACT)
    return vertices.at[:, jnp.asarray(pull.vertices)].add(moves)


def _apart(
    points: Float[Array, "S N 3"], first: Int[Array, " E"], second: Int[Array, " E"]
) -> tuple[Float[Array, "S E 3"], Float[Array, "S E"]]:
    """Vectors from the first ends of edges to the second ones, and their lengths."""
    apart = points[:, second] - points[:, first]
    return apart, jnp.sqrt((apart * apart).sum(-1) + 1e-12)
