"""Contact and friction between cloth and body, sampled at vertices and face centres.

A penalty on vertices alone lets coarse faces cut through the chest, and a linear one lets tight cloth sink in. Here
the pressure hardens with the cube of the depth, so that the same law is soft under the weight of a sleeve (tenths of
a millimetre) and holds tight woven cloth (tens of kilopascals) off the skin, at a stiffness the solver can take.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tryon_jax.contact.closest_points import SurfacePoint, follow_faces, point_on_faces
from tryon_jax.contact.surface import Surface
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.types import Scalar, pytree

SLIDING = 0.5
"""Share of the tangential stiffness that a sliding vertex keeps in the matrix. The true tangent of sliding is zero, but
a vertex that turns back is held by the full spring: with a tenth the solver alternates between the two for ever."""


@pytree
class ContactLaw:
    """Parameters of contact; pressures act on the cloth per square metre of rest area."""

    soft: Scalar = 1e5
    """Pascals per metre of approach where contact begins."""
    hard: Scalar = 1e7
    """Pascals per metre added at the skin; grows with the square of the approach."""
    tangential: Scalar = 1e4
    """Pascals per metre of elastic slip before the cloth slides."""


@pytree
class Contact:
    """Contact at one configuration."""

    point: SurfacePoint
    """Closest body points of the samples: V vertices, then F face centres."""
    force: Float[Array, " S"]
    """Normal force on each sample, newtons."""
    stiffness: Float[Array, " S"]
    """Normal stiffness of each sample, N/m."""
    load: Float[Array, " V"]
    """Normal force that each vertex carries, its share of its faces included, newtons."""


def sample_points(x: Float[Array, "V 3"], cloth: Cloth) -> Float[Array, "S 3"]:
    """Positions of the contact samples: vertices, then face centres."""
    return jnp.concatenate([x, x[cloth.faces].mean(1)])


def pressure(
    approach: Float[Array, " S"], thickness: Float[Array, ""], law: ContactLaw
) -> tuple[Float[Array, " S"], Float[Array, " S"]]:
    """Pressure (Pa) and its slope (Pa/m) for an approach of `thickness − distance`; linear beyond the skin.

    Args:
        approach: Thickness minus distance of each sample, metres.
        thickness: Of the cloth's contact layer, metres.
        law: Constants of contact.
    """
    depth = jnp.maximum(approach, 0.0)
    inside = jnp.minimum(depth / thickness, 1.0)
    slope = (law.soft + law.hard * inside * inside) * (approach > 0)
    value = law.soft * depth + law.hard * (inside**3 * thickness / 3 + inside**2 * (depth - inside * thickness))
    return jnp.asarray(value), jnp.asarray(slope)


def contact_forces(
    x: Float[Array, "V 3"],
    face: Int[Array, " S"],
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    law: ContactLaw,
    margin: Scalar,
) -> Contact:
    """Contact forces at `x`, following each sample's closest body face from its last one.

    Args:
        x: Vertices, metres.
        face: The body face that each sample was closest to last.
        cloth: Rest state.
        fabric: Material.
        surface: The body.
        law: Constants of contact.
        margin: The stiffness is that of a contact so much deeper, metres, so that Newton's steps do not overshoot the
            hardening.
    """
    followed = follow_faces(surface, sample_points(x, cloth), face)
    return contact_at_faces(x, followed, cloth, fabric, surface, law, margin)


def contact_at_faces(
    x: Float[Array, "V 3"],
    face: Int[Array, " S"],
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    law: ContactLaw,
    margin: Scalar,
) -> Contact:
    """`contact_forces` with each sample's body face as given: differentiable in all but the faces.

    Args:
        x: Vertices, metres.
        face: The body face that each sample touches.
        cloth: Rest state.
        fabric: Material.
        surface: The body.
        law: Constants of contact.
        margin: As in `contact_forces`.
    """
    point = point_on_faces(surface, sample_points(x, cloth), face)
    # Vertices and face centres share the area evenly: both must be held off, neither counts double.
    areas = 0.5 * jnp.concatenate([cloth.vertex_areas, cloth.face_areas])
    thickness = jnp.asarray(fabric.thickness, x.dtype)
    approach = thickness - point.height
    value, _ = pressure(approach, thickness, law)
    _, slope = pressure(approach + jnp.where(approach > 0, margin, 0.0), thickness, law)
    force = areas * value
    count = len(x)
    shares = jnp.broadcast_to(force[count:, None] / 3, cloth.faces.shape)
    load = force[:count].at[cloth.faces].add(shares)
    return Contact(point, force, areas * slope, load)


def normal_gradient(contact: Contact, cloth: Cloth) -> Float[Array, "V 3"]:
    """Gradient of the contact energy at the vertices, newtons."""
    gradient = -contact.force[:, None] * contact.point.normal
    count = cloth.vertex_areas.shape[0]
    at_faces = jnp.broadcast_to(gradient[count:, None, :] / 3, (*cloth.faces.shape, 3))
    return gradient[:count].at[cloth.faces].add(at_faces)


def normal_hessian(contact: Contact, cloth: Cloth) -> tuple[Float[Array, "V 3 3"], Float[Array, "F 3 3"]]:
    """Stiffness blocks of the vertices' own samples, and the block that all nine pairs of a face share."""
    n = contact.point.normal
    blocks = contact.stiffness[:, None, None] * n[:, :, None] * n[:, None, :]
    count = cloth.vertex_areas.shape[0]
    return blocks[:count], blocks[count:] / 9


def friction(
    slip: Float[Array, "V 3"], contact: Contact, cloth: Cloth, fabric: Fabric, law: ContactLaw
) -> tuple[Float[Array, "V 3"], Float[Array, " V"], Float[Array, "V 3 3"]]:
    """Elastic slip with a Coulomb cap: a spring in the tangent plane that gives way at friction × load.

    Unlike friction as a function of velocity it has true static equilibria: cloth at rest does not creep.

    Args:
        slip: Elastic slip of each vertex, metres.
        contact: From `contact_forces`.
        cloth: Rest state.
        fabric: Material.
        law: Constants of contact.

    Returns:
        The slip after the step (projected and capped, metres), the tangential stiffness of each vertex (N/m) for the
        solver, and the projection onto each vertex's tangent plane. The friction force is −tangential · area · slip.
    """
    count = cloth.vertex_areas.shape[0]
    n = contact.point.normal[:count]
    tangent = jnp.eye(3, dtype=slip.dtype)[None] - n[:, :, None] * n[:, None, :]
    spring = law.tangential * cloth.vertex_areas
    slip = (tangent * slip[:, None, :]).sum(-1)
    limit = jnp.asarray(fabric.friction, slip.dtype) * contact.load / jnp.maximum(spring, 1e-12)
    length = jnp.sqrt((slip * slip).sum(-1) + 1e-20)
    slip = slip * jnp.minimum(1.0, limit / length)[:, None]
    stiffness = jnp.where(contact.load > 0, spring * jnp.where(length >= limit, SLIDING, 1.0), 0.0)
    return slip, stiffness, tangent
