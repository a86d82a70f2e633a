"""The rest state of a cloth as a function of its pattern's coordinates, and those as one of the design.

`at_rest(state, with_rest_shape(cloth, corners, uv_near(pattern, design)), fabric, surface)` has the derivatives of a
drape at rest by the parameters of its design.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tryon_jax.mesh.topology import hinges as find_hinges
from tryon_jax.physics.cloth import Cloth
from tryon_jax.types import EXACT, ArrayLike, pytree


@pytree
class RestCorners:
    """Where a cloth's faces and hinges lie in the pattern: indices into its coordinates, padded like the cloth."""

    faces: Int[ArrayLike, "F 3"]
    hinges: Int[ArrayLike, "H 2 2"]
    """The two ends of each hinge's edge, in each of its two faces: a seam has an edge in either panel."""
    hinge_faces: Int[ArrayLike, "H 2"]


@pytree
class PatternNearDesign:
    """A pattern's coordinates near one design, where they are linear in its parameters."""

    design: Float[ArrayLike, " P"]
    """Parameters of the design that it was cut by, metres."""
    uv: Float[ArrayLike, "U 2"]
    """Coordinates at that design, metres."""
    slope: Float[ArrayLike, "U 2 P"]
    """Their derivative, from `garment.pattern_derivative`."""


def uv_near(pattern: PatternNearDesign, design: Float[ArrayLike, " P"]) -> Float[Array, "U 2"]:
    """Pattern coordinates at a design near the pattern's own, metres, to first order; jittable, differentiable.

    Args:
        pattern: The pattern with its derivative.
        design: Parameters, metres.
    """
    change = jnp.asarray(design) - jnp.asarray(pattern.design)
    return jnp.asarray(pattern.uv) + jnp.einsum("ucp,p->uc", jnp.asarray(pattern.slope), change, precision=EXACT)


def find_rest_corners(
    cloth: Cloth, faces: Int[np.ndarray, "T 3"], faces_uv: Int[np.ndarray, "T 3"], num_vertices: int
) -> RestCorners:
    """The corners of a cloth that `build_cloth` made from the same arrays (host side).

    Args:
        cloth: What `build_cloth` returned.
        faces: Triangles over the welded vertices.
        faces_uv: Index into the pattern's coordinates for each corner.
        num_vertices: Number of welded vertices.
    """
    hinges, pairs = find_hinges(faces, num_vertices)
    ends = np.zeros((len(cloth.hinges), 2, 2), np.int32)
    for side in (0, 1):
        face = pairs[:, side]
        for end in (0, 1):
            corner = np.argmax(faces[face] == hinges[:, end][:, None], axis=1)
            ends[: len(hinges), side, end] = faces_uv[face, corner]
    padded = np.zeros((len(cloth.faces), 3), np.int32)
    padded[: len(faces)] = faces_uv
    beside = np.zeros((len(cloth.hinges), 2), np.int32)
    beside[: len(hinges)] = pairs
    return RestCorners(padded, ends, beside)


def with_rest_shape(cloth: Cloth, corners: RestCorners, uv: Float[Array, "U 2"]) -> Cloth:
    """The cloth cut from other coordinates of the same pattern mesh: jittable and differentiable in `uv`.

    Args:
        cloth: From `build_cloth`; its connectivity is kept.
        corners: From `find_rest_corners`.
        uv: Coordinates, metres; no face may be turned over.
    """
    real = jnp.asarray(cloth.face_areas) > 0
    at = uv[jnp.asarray(corners.faces)]
    first, second = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    # Padding takes the place of a right-angled triangle, so that nothing is divided by zero.
    first = jnp.where(real[:, None], first, jnp.array([1.0, 0.0], uv.dtype)[None])
    second = jnp.where(real[:, None], second, jnp.array([0.0, 1.0], uv.dtype)[None])
    determinant = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    along = jnp.stack([second[:, 1], -second[:, 0]], axis=1) / determinant[:, None]
    across = jnp.stack([-first[:, 1], first[:, 0]], axis=1) / determinant[:, None]
    gradients = jnp.stack([-(along + across), along, across], axis=1)
    areas = jnp.where(real, 0.5 * jnp.abs(determinant), 0.0)

    hinged = jnp.asarray(cloth.hinge_shape) > 0
    ends = uv[jnp.asarray(corners.hinges)]
    edges = jnp.where(hinged[:, None, None], ends[:, :, 1] - ends[:, :, 0], 1.0)
    lengths = jnp.sqrt((edges * edges).sum(-1)).mean(axis=1)
    both = jnp.where(hinged, areas[jnp.asarray(corners.hinge_faces)].sum(axis=1), 1.0)
    vertex_areas = jnp.zeros_like(cloth.vertex_areas).at[jnp.asarray(cloth.faces)].add(areas[:, None] / 3)
    return replace(
        cloth,
        shape_gradients=jnp.where(real[:, None, None], gradients, 0.0),
        face_areas=areas,
        hinge_shape=jnp.where(hinged, lengths**2 / (4 * both), 0.0),
        hinge_curvature=jnp.where(hinged, lengths / (2 * both), 0.0),
        hinge_grain=jnp.arctan2(jnp.abs(edges[:, :, 1]), jnp.abs(edges[:, :, 0])),
        vertex_areas=vertex_areas,
    )
