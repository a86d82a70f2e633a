"""Device side, pure: a drape kept clear of bodies of all shapes at the price of one small product.

How far a garment vertex is from the skin changes smoothly with the body's shape. So that distance is measured on some
bodies once for a garment, and is a polynomial of the betas from then on; where it is less than the clearance, the
vertex moves out by what is missing. This does to drape fields what a repulsive unit does to a network's prediction (Tan
et al., *A repulsive force unit for garment collision handling in neural networks*, ECCV 2022), but asks no other body
than those few.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.body.shape_polynomial import fit_polynomials
from tryon_jax.contact.collision_loss import closest_vertices
from tryon_jax.contact.skin_samples import SkinSamples
from tryon_jax.types import EXACT, ArrayLike, pytree

KEPT_CLEAR = 0.002
"""Distance from the skin that is kept, metres: simulated cloth rests a little farther out."""
_FAR = 0.03
"""Distances are cut to this before they become a polynomial, metres: cloth far out does not matter."""
_FARTHEST = 0.02
"""No vertex moves more than this, metres."""
_STEPS = 1
"""Moves in search of the closest body vertex, from that on the mean body."""
_REACH = 0.01
"""Width of the average over body vertices, which are 1 to 2 cm apart, metres."""
_AT_ONCE = 1 << 17
"""Vertices times bodies that are measured at once."""


@pytree
class Clearance:
    """Distance of each vertex of a garment from the skin, as a function of the body's shape."""

    distance: Float[ArrayLike, "*batch M T"]
    """Coefficients of its polynomial, metres."""
    outward: Float[ArrayLike, "*batch M 3"]
    """Unit direction in which it grows; zero at padding."""


def measure_clearance(
    samples: SkinSamples,
    drapes: Float[Array, "S M 3"],
    start: Int[ArrayLike, " M"],
    mask: Bool[ArrayLike, " M"],
) -> Clearance:
    """The distance of a garment from the skin, from its drapes on the bodies of `samples`.

    It is an average of the distances from the tangent planes of the body vertices around the closest one, so that it is
    continuous (implicit moving least squares; Kolluri, *Provably good moving least squares*, 2008).

    Args:
        samples: From `sample_skin` of the body.
        drapes: One for each of its shapes, metres.
        start: The body vertex closest to each garment vertex on the mean body.
        mask: False for padding, which does not move.
    """
    counts = jnp.asarray(samples.counts)

    def of_one(
        one: tuple[Float[Array, "W 3"], Float[Array, "W 3"], Float[Array, "M 3"]],
    ) -> tuple[Float[Array, " M"], Float[Array, "M 3"]]:
        skin, normals, points = one
        closest, _ = closest_vertices(samples.neighbours, skin, points, start, _STEPS)
        around = jnp.asarray(samples.neighbours.index)[closest]
        offset, away = points[:, None] - skin[around], normals[around]
        squared = (offset * offset).sum(-1)
        weight = jax.nn.softmax(-squared / _REACH**2, axis=1)
        distance = (weight * (offset * away).sum(-1)).sum(-1)
        # A tangent plane says nothing about cloth that is far from where it touches.
        near = 2.0 - jnp.sqrt(squared.min(axis=1) + 1e-12) / _FAR
        near = jnp.where(counts[closest], jnp.clip(near, 0.0, 1.0), 0.0)
        return near * distance + (1.0 - near) * _FAR, (weight[..., None] * away).sum(axis=1)

    at_once = max(1, min(len(drapes), _AT_ONCE // drapes.shape[1]))
    every = jnp.asarray(samples.vertices, drapes.dtype), jnp.asarray(samples.normals, drapes.dtype), drapes
    distance, away = jax.lax.map(of_one, every, batch_size=at_once)
    mean = jnp.where(jnp.asarray(mask)[:, None], away.sum(axis=0), 0.0)
    # The derivative of a length is not defined at zero, as at padding.
    outward = mean / jnp.sqrt((mean * mean).sum(-1, keepdims=True) + 1e-12)
    return Clearance(fit_polynomials(samples.polynomials, jnp.clip(distance, -_FAR, _FAR)), outward)


def keep_clear(
    clearance: Clearance, vertices: Float[Array, "B M 3"], terms: Float[Array, "B T"]
) -> Float[Array, "B M 3"]:
    """Drapes with their vertices moved out where they are closer to the skin than `KEPT_CLEAR`.

    Args:
        clearance: Of the garment, from `measure_clearance`.
        vertices: Its drapes on some bodies, metres.
        terms: From `polynomial_terms` of these bodies.
    """
    distance = jnp.einsum("bt,mt->bm", terms, jnp.asarray(clearance.distance), precision=EXACT)
    missing = jnp.clip(KEPT_CLEAR - distance, 0.0, _FARTHEST)
    return vertices + missing[..., None] * jnp.asarray(clearance.outward)[None]
