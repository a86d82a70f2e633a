"""The linear system of one implicit step."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.contact.surface import Surface
from tryon_jax.physics.block_matrix import BlockMatrix
from tryon_jax.physics.body_contact import contact_forces, friction, normal_gradient, normal_hessian
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.elasticity import deform, elastic_blocks, elastic_gradient
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.self_contact import SelfPairs, self_contact
from tryon_jax.physics.state import GRAVITY, ClothState, SolverSettings
from tryon_jax.types import EXACT, pytree


@pytree
class System:
    """What a step solves, and what it needs once that is solved."""

    matrix: BlockMatrix
    """Positive definite, N/m."""
    right: Float[Array, "V 3"]
    gradient: Float[Array, "V 3"]
    """Minus the net force, newtons."""
    load: Float[Array, " V"]
    """Normal force that each vertex carries, newtons."""
    slip: Float[Array, "V 3"]
    plane: Float[Array, "V 3 3"]
    """Projection onto the tangent plane of the body."""
    motion: Float[Array, "V 3"]
    """How far the skin below has moved, metres."""
    weight: Float[Array, " V"]
    """Newtons, on the earth."""
    face: Int[Array, " S"]
    depth: Float[Array, ""]
    """Deepest contact sample below the skin, metres."""


def still_system(state: ClothState, cloth: Cloth) -> System:
    """A system that moves nothing."""
    vectors = jnp.zeros_like(state.x)
    slots, count = cloth.incidence.neighbours.shape
    blocks = jnp.zeros((slots, 3, 3, count), vectors.dtype)
    return System(
        matrix=BlockMatrix(jnp.zeros_like(blocks[0]) + jnp.eye(3, dtype=vectors.dtype)[:, :, None], blocks),
        right=vectors,
        gradient=vectors,
        load=vectors[:, 0],
        slip=vectors,
        plane=jnp.zeros((count, 3, 3), vectors.dtype),
        motion=vectors,
        weight=vectors[:, 0],
        face=jnp.zeros_like(state.face),
        depth=jnp.zeros((), vectors.dtype),
    )


def assemble(
    state: ClothState,
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    settings: SolverSettings,
    surface_motion: Float[Array, "W 3"],
    pairs: SelfPairs | None = None,
) -> System:
    """The system of a step from `state`.

    Args:
        state: Where the cloth is.
        cloth: Rest state.
        fabric: Material.
        surface: The body.
        settings: Of the step.
        surface_motion: How far each body vertex has moved since the last step, metres.
        pairs: Parts of the cloth that must not pass through each other.
    """
    dtype = state.x.dtype
    h = jnp.asarray(settings.time_step, dtype)
    count = len(state.x)
    mass = cloth.vertex_areas * jnp.asarray(fabric.density, dtype)

    deformation = deform(state.x, cloth, fabric, state.remainder)
    contact = contact_forces(state.x, state.face, cloth, fabric, surface, settings.law, settings.contact_margin)
    slip, grip, plane = friction(state.slip, contact, cloth, fabric, settings.law)
    at_vertices, at_faces = normal_hessian(contact, cloth)

    gradient = elastic_gradient(deformation, cloth) + normal_gradient(contact, cloth)
    gradient = gradient.at[:, 1].add(mass * settings.gravity)
    gradient = gradient + (settings.law.tangential * cloth.vertex_areas)[:, None] * slip

    inertia = jnp.where(cloth.active > 0, mass / (h * h), 1.0)
    added = at_vertices + grip[:, None, None] * plane
    added = added + inertia[:, None, None] * jnp.eye(3, dtype=dtype)[None]
    if pairs is not None:
        law, margin = settings.law, settings.contact_margin
        between, held = self_contact(state.x, pairs, cloth.vertex_areas, law, margin)
        gradient, added = gradient + between, added + held

    elastic = elastic_blocks(deformation, cloth, fabric, at_faces)
    matrix = BlockMatrix(elastic.diagonal + added.transpose(1, 2, 0), elastic.beside)

    corners = surface.faces[contact.point.face[:count]]
    motion = jnp.einsum("vk,vkc->vc", contact.point.barycentric[:count], surface_motion[corners], precision=EXACT)
    drag = grip[:, None] * (plane * motion[:, None, :]).sum(-1)
    right = (mass / h * settings.retention)[:, None] * state.velocity - gradient + drag
    shape_weight = jnp.concatenate([cloth.vertex_areas, cloth.face_areas])
    return System(
        matrix=matrix,
        right=jnp.asarray(right * cloth.active[:, None]),
        gradient=gradient,
        load=contact.load,
        slip=slip,
        plane=plane,
        motion=motion,
        weight=jnp.asarray(mass * GRAVITY * cloth.active),
        face=contact.point.face,
        depth=jnp.max(jnp.where(shape_weight > 0, -contact.point.height, -1.0)),
    )


def residual(system: System, cloth: Cloth, pinned: Bool[Array, " V"] | None) -> Float[Array, ""]:
    """Norm of the net force on all free vertices over the norm of their weights plus contact loads.

    Args:
        system: Of the state.
        cloth: Rest state.
        pinned: Vertices that stay where they are; None leaves all free.
    """
    free = (cloth.active if pinned is None else jnp.where(pinned, 0.0, cloth.active))[:, None]
    scale = jnp.linalg.norm(system.weight) + jnp.linalg.norm(system.load)
    return jnp.linalg.norm(system.gradient * free) / scale
