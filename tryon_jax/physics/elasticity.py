"""Stretch and bending together: the gradient at the vertices, and the tangent as blocks of the system matrix."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.physics.bending import dihedral_angles, hinge_roots, hinge_stiffness
from tryon_jax.physics.block_matrix import BlockMatrix
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.incidence import gather, pick
from tryon_jax.physics.stretch import deformation_gradients, face_gradient, face_hessian, green_strain, stress
from tryon_jax.types import pytree


@pytree
class Deformation:
    """How faces and hinges are deformed, for the gradient and the tangent alike."""

    gradients: Float[Array, "F 3 2"]
    strain: Float[Array, "F 3"]
    stress: Float[Array, "F 3"]
    angle: Float[Array, " H"]
    slope: Float[Array, "H 4 3"]
    """Gradient of the angle."""
    stiffness: Float[Array, " H"]
    """k_e · shape of each hinge, N·m."""


def deform(
    x: Float[Array, "V 3"], cloth: Cloth, fabric: Fabric, remainder: Float[Array, "V 3"] | None = None
) -> Deformation:
    """Deformation of the cloth at `x`.

    Bending is computed at `x`; stretch, which is stiffer by far, at `x + remainder`.

    Args:
        x: Vertices, metres.
        cloth: Rest state.
        fabric: Material.
        remainder: What rounding took from `x`, metres; nothing when None.
    """
    gradients = deformation_gradients(x, cloth, remainder)
    strain = green_strain(gradients)
    angle, slope = dihedral_angles(x, cloth)
    stiffness = hinge_stiffness(angle, cloth, fabric) * cloth.hinge_shape
    return Deformation(gradients, strain, stress(strain, fabric), angle, slope, stiffness)


def elastic_gradient(deformation: Deformation, cloth: Cloth) -> Float[Array, "V 3"]:
    """Gradient of stretch and bending at the vertices, newtons."""
    at_faces = face_gradient(deformation.gradients, deformation.stress, cloth).transpose(2, 1, 0)
    at_hinges = (deformation.stiffness * deformation.angle)[None, None] * deformation.slope.transpose(2, 1, 0)
    at_vertices = gather(at_faces.reshape(3, -1), cloth.incidence.faces)
    return (at_vertices + gather(at_hinges.reshape(3, -1), cloth.incidence.hinges)).T


def elastic_blocks(
    deformation: Deformation, cloth: Cloth, fabric: Fabric, at_faces: Float[Array, "F 3 3"] | None = None
) -> BlockMatrix:
    """Positive semi-definite tangent of stretch and bending, N/m.

    Args:
        deformation: Of the cloth.
        cloth: Rest state.
        fabric: Material.
        at_faces: Block that is added to all nine pairs of corners of each face, symmetric; none when None.
    """
    incidence = cloth.incidence
    state = deformation.gradients, deformation.strain, deformation.stress
    sides = face_hessian(*state, cloth, fabric)
    corners = -(sides + jnp.roll(sides, 1, axis=2).swapaxes(0, 1))
    if at_faces is not None:
        shared = at_faces.transpose(1, 2, 0)[:, :, None]
        sides, corners = sides + shared, corners + shared
    roots = hinge_roots(deformation.stiffness, deformation.slope)
    # Their own blocks stand in for the one between the opposite corners (see `hinge_roots`).
    doubled = roots * np.sqrt([1.0, 1.0, 2.0, 2.0]).astype(roots.dtype)[None, :, None]
    flat = sides.reshape(3, 3, -1), corners.reshape(3, 3, -1), roots.reshape(3, -1), doubled.reshape(3, -1)
    # Barriers keep what is gathered from being computed anew for every place that it is gathered to.
    sides, corners, roots, doubled = jax.lax.optimization_barrier(flat)

    met = pick(doubled, incidence.hinges)
    diagonal = gather(corners, incidence.faces) + (met[:, None] * met[None]).sum(2)
    edges = gather(sides, incidence.sides) + gather(sides, incidence.sides_back).swapaxes(0, 1)
    for start, end in zip(*jnp.asarray(incidence.edge_hinges), strict=True):
        edges = edges + pick(roots, start)[:, None] * pick(roots, end)[None]
    both = jax.lax.optimization_barrier(jnp.concatenate([edges, edges.swapaxes(0, 1)], axis=2))
    return BlockMatrix(diagonal, pick(both, incidence.edges).transpose(2, 0, 1, 3))
