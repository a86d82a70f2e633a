"""Derivatives of cloth at rest, by the implicit function theorem.

At rest the net force F(x; θ) on every vertex is zero, so that dx/dθ = −(∂F/∂x)⁻¹ ∂F/∂θ: nothing is differentiated
through the solver's steps. The contact set is that of the rest state: each sample keeps its body face, vertices that
stick hang on a spring from the skin that they stuck to, those that slide keep friction × load. Cloth that has slid to
its place is at the limit of friction: the derivative is that of sliding on, and a change that takes it back, where it
would stick, does less. Without friction both sides agree.
"""

import jax
import jax.numpy as jnp
from jax.scipy.sparse.linalg import bicgstab
from jaxtyping import Array, Bool, Float

from tryon_jax.contact.closest_points import point_on_faces
from tryon_jax.contact.surface import Surface
from tryon_jax.physics.block_matrix import invert_blocks
from tryon_jax.physics.body_contact import (
    ContactLaw,
    contact_at_faces,
    friction,
    normal_gradient,
)
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.elasticity import deform, elastic_gradient
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.solver import tangent_blocks
from tryon_jax.physics.state import ClothState, SolverSettings
from tryon_jax.types import EXACT, Scalar

TOLERANCE = 1e-6
ITERATIONS = 3000


def at_rest(
    state: ClothState,
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    settings: SolverSettings | None = None,
    pinned: Bool[Array, " V"] | None = None,
    tolerance: float = TOLERANCE,
    iterations: int = ITERATIONS,
) -> Float[Array, "V 3"]:
    """Positions of a cloth that the solver has brought to rest, as a function of what they depend on.

    The value is the state's own; its derivatives, forward and reverse, with respect to `cloth` (a design, by
    `rest_shape`), `fabric` and `surface` (a body's betas) are those of the equilibrium. Pure: jit, grad, jvp. Tested in
    double precision; in single precision the forces of stiff cloth are rounded, and so are their derivatives.

    Args:
        state: At rest, from `solve`; it is held constant.
        cloth: The rest shape.
        fabric: The material.
        surface: The body.
        settings: As for the solver; gravity and the contact law are read.
        pinned: Vertices that are held where they are.
        tolerance: Relative residual of the linear solve.
        iterations: Of the linear solver, at most.

    Returns:
        Positions, metres.
    """
    settings = settings or SolverSettings()
    state, start = jax.lax.stop_gradient((state, surface))
    x0 = state.x + state.remainder
    held = (jnp.asarray(cloth.active) == 0) | (False if pinned is None else pinned)
    blocks = tangent_blocks(state, *jax.lax.stop_gradient((cloth, fabric)), start, settings)
    inverse = jax.lax.stop_gradient(invert_blocks(blocks.diagonal))

    def imbalance(x: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        force = net_gradient(x, state, start, cloth, fabric, surface, settings.law, settings.gravity)
        return jnp.where(held[:, None], x - x0, force)

    def precondition(force: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        moved = jnp.einsum("ijv,vj->vi", inverse, force, precision=EXACT)
        return jnp.where(held[:, None], force, moved)

    def solve(product, right):
        return bicgstab(product, right, tol=tolerance, maxiter=iterations, M=precondition)[0]

    def linear(product, right):
        return jax.lax.custom_linear_solve(product, right, solve, solve)

    return jax.lax.custom_root(imbalance, x0, lambda _, found: found, linear)


def net_gradient(
    x: Float[Array, "V 3"],
    rest: ClothState,
    rest_surface: Surface,
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    law: ContactLaw,
    gravity: Scalar,
) -> Float[Array, "V 3"]:
    """Minus the net force on each vertex near a rest state, newtons: zero there, up to the solver's tolerance.

    Args:
        x: Positions, metres.
        rest: The rest state: which face each sample touches, and the slip of friction.
        rest_surface: The body at rest.
        cloth: The rest shape.
        fabric: The material.
        surface: The body, with the topology of `rest_surface`.
        law: Of contact.
        gravity: m/s², along −y.
    """
    gradient = elastic_gradient(deform(x, cloth, fabric), cloth)
    contact = contact_at_faces(x, rest.face, cloth, fabric, surface, law, 0.0)
    mass = cloth.vertex_areas * jnp.asarray(fabric.density, x.dtype)
    weight = jnp.zeros_like(x).at[:, 1].set(mass * gravity)
    # The skin carries the anchor of friction along, at the point that was touched at rest.
    count = len(x)
    x0, face = rest.x + rest.remainder, rest.face[:count]
    touched = point_on_faces(rest_surface, x0, face).barycentric
    corners = surface.faces[face]
    carried = jnp.einsum("vk,vkc->vc", touched, surface.vertices[corners] - rest_surface.vertices[corners])
    slip, _, _ = friction(rest.slip + (x - x0) - carried, contact, cloth, fabric, law)
    grip = jnp.where(contact.load > 0, law.tangential * cloth.vertex_areas, 0.0)
    return gradient + weight + normal_gradient(contact, cloth) + grip[:, None] * slip
