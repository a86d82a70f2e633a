"""Device side, pure: what sums of fields get wrong on single bodies, put right once for all bodies of a garment.

Fields are learned for all bodies at once. On a body at the border of the range they may stretch an edge or enter the
skin. Both are measured on the bodies of `SkinSamples` when the fields are made, and corrected on any body by
polynomials of its shape, without another look at the body.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from tryon_jax.body.shape_polynomial import ShapePolynomials, polynomial_terms
from tryon_jax.contact.clearance import Clearance, keep_clear, measure_clearance
from tryon_jax.contact.skin_samples import SkinSamples
from tryon_jax.tryon.carrying import carry_values
from tryon_jax.tryon.edge_pull import EdgePull, apply_pull, fit_pull, pull_together
from tryon_jax.tryon.garment import Garment
from tryon_jax.types import pytree


@pytree
class Corrections:
    """Of the drapes of one garment in one fabric."""

    polynomials: ShapePolynomials
    clearance: Clearance
    pull: EdgePull | None
    """None for a garment without rest lengths."""


def measure_corrections(
    skin: SkinSamples, garment: Garment, drapes: Float[Array, "S N 3"], carried: Float[Array, "S M 3"]
) -> Corrections:
    """What to correct in a garment's drapes.

    Args:
        skin: Of the body.
        garment: The garment.
        drapes: Its graph's on the bodies of `skin`, metres.
        carried: Those of the user's own mesh; the same where it is the graph's.
    """
    pull = None
    if garment.edges is not None and garment.rest is not None:
        moves = carry_values(garment, jnp.moveaxis(pull_together(drapes, garment.edges, garment.rest), 0, -1))
        pull = fit_pull(skin.polynomials, moves)
        carried = carried + jnp.moveaxis(moves, -1, 0)
    clearance = measure_clearance(skin, carried, garment.body_vertices, garment.mask)
    return Corrections(skin.polynomials, clearance, pull)


def correct(
    corrections: Corrections, vertices: Float[Array, "B M 3"], betas: Float[Array, "B b"]
) -> Float[Array, "B M 3"]:
    """The drapes on bodies of shape `betas`, corrected.

    Args:
        corrections: Of the garment and fabric.
        vertices: Its drapes as fields give them, metres.
        betas: Standard deviations.
    """
    terms = polynomial_terms(corrections.polynomials, betas)
    if corrections.pull is not None:
        vertices = apply_pull(corrections.pull, vertices, terms)
    return keep_clear(corrections.clearance, vertices, terms)
