"""In-plane elasticity: constant-strain triangles with a stiffness that depends on strain (Narain et al. 2012).

The measured stiffness k(G) is not the derivative of an energy. Forces follow the secant stress S = k(G) : G with k held
fixed, as in the model that the fabrics were fitted with.
"""

import itertools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.fabrics import GRID, GRID_LOW, Fabric
from tryon_jax.types import EXACT, ArrayLike

FLOOR = 2.0
"""N/m. Smallest axial and shear stiffness that the tangent assumes: clipped table entries would make it singular."""
MAX_TENSION = 300.0
"""N/m. Largest tension: a garment with more over a twentieth of its area could not be put on."""
MAX_STIFFENING = 20.0
"""Cap on how much stiffer than the secant the tangent may be: it is unbounded where principal strains coincide."""


def deformation_gradients(
    x: Float[Array, "V 3"], cloth: Cloth, remainder: Float[Array, "V 3"] | None = None
) -> Float[Array, "F 3 2"]:
    """Derivative of position with respect to (u, v) on each face, from edge vectors (exact under translation).

    Args:
        x: positions, metres.
        cloth: rest state.
        remainder: what is to be added to `x`, too small to be seen in its digits (none: nothing). The difference of
            neighbours is exact to its last digit, so that their strain then is, too.
    """
    edges = _edges(x, cloth)
    if remainder is not None:
        edges = edges + _edges(remainder, cloth)
    return jnp.einsum("fni,fnk->fik", edges, cloth.shape_gradients[:, 1:], precision=EXACT)


def _edges(x: Float[Array, "V 3"], cloth: Cloth) -> Float[Array, "F 2 3"]:
    corners = x[cloth.faces]
    return corners[:, 1:] - corners[:, :1]


def green_strain(gradients: Float[Array, "F 3 2"]) -> Float[Array, "F 3"]:
    """(G00, G11, 2 G01) of the Green strain (FᵀF − I)/2."""
    u, v = gradients[..., 0], gradients[..., 1]
    return jnp.stack([0.5 * ((u * u).sum(-1) - 1), 0.5 * ((v * v).sum(-1) - 1), (u * v).sum(-1)], axis=-1)


def stiffness(strain: Float[Array, "F 3"], fabric: Fabric) -> Float[Array, "F 4"]:
    """k(G), N/m (warp, coupling, weft, shear): trilinear in the fabric's table, clamped at its ends."""
    return stiffness_and_slope(strain, fabric)[0]


def stiffness_and_slope(
    strain: Float[Array, "F 3"], fabric: Fabric
) -> tuple[Float[Array, "F 4"], Float[Array, "F 4 3"]]:
    """k(G) and its derivative with respect to (G00, G11, 2 G01) inside the table's cell."""
    # The table is over |G01|, half of the third component. Faces come last: the table is read along vector registers.
    half = jnp.where(strain[:, 2] < 0, -0.5, 0.5)
    sign = jnp.stack([jnp.ones_like(half), jnp.ones_like(half), half])
    offset = jnp.array([GRID_LOW, GRID_LOW, 0.0], strain.dtype)[:, None]
    scaled = jnp.clip((strain.T * sign - offset) * GRID, 0.0, GRID - 1 - 1e-5)
    low = scaled.astype(jnp.int32)
    high = scaled - low
    table = jnp.asarray(fabric.stretch_table, strain.dtype).reshape(-1, 4).T
    base = (low[0] * GRID + low[1]) * GRID + low[2]
    value = jnp.zeros((4, len(strain)), strain.dtype)
    slope = [jnp.zeros_like(value) for _ in range(3)]
    for corner in itertools.product((0, 1), repeat=3):
        weights = [high[a] if c else 1 - high[a] for a, c in enumerate(corner)]
        at = base + ((corner[0] * GRID + corner[1]) * GRID + corner[2])
        entry = table.at[:, at].get(mode="promise_in_bounds")
        value = value + (weights[0] * weights[1] * weights[2])[None] * entry
        for axis in range(3):
            others = [w for a, w in enumerate(weights) if a != axis]
            side = 1.0 if corner[axis] else -1.0
            slope[axis] = slope[axis] + (side * others[0] * others[1])[None] * entry
    return value.T, (jnp.stack(slope, axis=1) * (GRID * sign)[None]).transpose(2, 0, 1)


def _secant_stress(strain: Float[Array, "F 3"], k: Float[Array, "F 4"]) -> Float[Array, "F 3"]:
    return jnp.stack(
        [
            k[:, 0] * strain[:, 0] + k[:, 1] * strain[:, 1],
            k[:, 1] * strain[:, 0] + k[:, 2] * strain[:, 1],
            0.5 * k[:, 3] * strain[:, 2],
        ],
        axis=-1,
    )


def stress(strain: Float[Array, "F 3"], fabric: Fabric) -> Float[Array, "F 3"]:
    """Second Piola-Kirchhoff stress (S00, S11, S01), N/m."""
    return _secant_stress(strain, stiffness(strain, fabric))


@jax.jit
def tension_along(stretch: Float[ArrayLike, ""], direction: Float[ArrayLike, "2"], fabric: Fabric) -> Float[Array, ""]:
    """Tension, N/m, of cloth that is stretched along a direction of its pattern and kept as it is across.

    Args:
        stretch: length over natural length.
        direction: unit vector (warp, weft).
        fabric: the cloth.
    """
    u, v = jnp.asarray(direction)
    # Strain and stress are (00, 11, twice 01) and (00, 11, 01): the same factors serve for both.
    along = jnp.stack([u * u, v * v, 2 * u * v])
    green = 0.5 * (jnp.asarray(stretch) ** 2 - 1) * along
    return stress(green[None], fabric)[0] @ along


def stretch_energy(x: Float[Array, "V 3"], cloth: Cloth, fabric: Fabric) -> Float[Array, ""]:
    """Stored energy, joules, whose negative gradient is `stretch_force`.

    The stiffness is a constant to differentiation, so that the gradient is the secant force of the measured model.

    Args:
        x: Vertices, metres.
        cloth: Rest state.
        fabric: Material.
    """
    strain = green_strain(deformation_gradients(x, cloth))
    k = jax.lax.stop_gradient(stiffness(strain, fabric))
    return 0.5 * (cloth.face_areas * (strain * _secant_stress(strain, k)).sum(-1)).sum()


def stretch_force(x: Float[Array, "V 3"], cloth: Cloth, fabric: Fabric) -> Float[Array, "V 3"]:
    """Force on each vertex, newtons: −A F S B per face.

    Args:
        x: Vertices, metres.
        cloth: Rest state.
        fabric: Material.
    """
    gradients = deformation_gradients(x, cloth)
    s = stress(green_strain(gradients), fabric)
    return jnp.zeros_like(x).at[cloth.faces].add(-face_gradient(gradients, s, cloth))


def face_gradient(gradients: Float[Array, "F 3 2"], s: Float[Array, "F 3"], cloth: Cloth) -> Float[Array, "F 3 3"]:
    """Gradient of the energy at the corners of each face, newtons.

    Args:
        gradients: Deformation gradient of each face.
        s: Second Piola-Kirchhoff stress of each face (uu, vv, uv), N/m.
        cloth: Rest state.
    """
    u, v = gradients[..., 0], gradients[..., 1]
    first = u * s[:, None, 0] + v * s[:, None, 2]
    second = u * s[:, None, 2] + v * s[:, None, 1]
    b = jnp.asarray(cloth.shape_gradients) * jnp.asarray(cloth.face_areas)[:, None, None]
    return b[:, :, 0, None] * first[:, None, :] + b[:, :, 1, None] * second[:, None, :]


def face_hessian(
    gradients: Float[Array, "F 3 2"], strain: Float[Array, "F 3"], s: Float[Array, "F 3"], cloth: Cloth, fabric: Fabric
) -> Float[Array, "3 3 3 F"]:
    """Tangent blocks of each face [xyz, xyz, side, face]: side k couples corner k to the next one.

    The block of the opposite direction is the transpose; the block of a corner with itself is minus the sum of its row
    (the cloth may be moved as a whole), which makes the tangent positive semi-definite.

    The true tangent dS/dG is neither symmetric nor definite; freezing k instead underestimates it and lets the solver
    cycle for ever. Its symmetric part, scaled by the secant's diagonal, is bounded from above by the diagonal of its
    absolute row sums (Gershgorin), which converges. The geometric part keeps the tensile eigenvalues of the stress.

    Args:
        gradients: Deformation gradient of each face.
        strain: Green strain of each face (uu, vv, uv).
        s: Second Piola-Kirchhoff stress of each face (uu, vv, uv), N/m.
        cloth: Rest state.
        fabric: Material.
    """
    k, slope = stiffness_and_slope(strain, fabric)
    k, slope, g = k.T, slope.transpose(1, 2, 0), strain.T[:, None]
    diagonal = jnp.maximum(jnp.stack([k[0], k[2], 0.5 * k[3]]), FLOOR)
    zero = jnp.zeros_like(k[0])
    rows = (
        jnp.stack([k[0], k[1], zero]) + slope[0] * g[0] + slope[1] * g[1],
        jnp.stack([k[1], k[2], zero]) + slope[1] * g[0] + slope[2] * g[1],
        jnp.stack([zero, zero, 0.5 * k[3]]) + 0.5 * slope[3] * g[2],
    )
    scale = jnp.sqrt(diagonal)
    tangent = [[0.5 * jnp.abs(rows[i][j] + rows[j][i]) / scale[i] / scale[j] for j in range(3)] for i in range(3)]
    stiffening = jnp.stack([sum(row) for row in tangent])
    areas = jnp.asarray(cloth.face_areas)[None]
    weights = diagonal * jnp.clip(stiffening, 1.0, MAX_STIFFENING) * areas
    tension = _positive_part(s).T * areas

    b = jnp.asarray(cloth.shape_gradients).transpose(1, 2, 0)[:, :, None]
    u, v = gradients[..., 0].T, gradients[..., 1].T
    strains = [(b[c, 0] * u, b[c, 1] * v, b[c, 0] * v + b[c, 1] * u) for c in range(3)]
    sides = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        material = sum(
            w[None, None] * x[:, None] * y[None] for w, x, y in zip(weights, strains[i], strains[j], strict=True)
        )
        geometric = tension[:1] * b[i, 0] * b[j, 0] + tension[1:2] * b[i, 1] * b[j, 1]
        geometric = geometric + tension[2:] * (b[i, 0] * b[j, 1] + b[i, 1] * b[j, 0])
        sides.append(material + geometric[None] * jnp.eye(3, dtype=strain.dtype)[:, :, None])
    return jnp.stack(sides, axis=2)


def _positive_part(s: Float[Array, "F 3"]) -> Float[Array, "F 3"]:
    """The symmetric 2 x 2 matrix (S00, S11, S01) with its negative eigenvalue removed."""
    mean, half = 0.5 * (s[:, 0] + s[:, 1]), 0.5 * (s[:, 0] - s[:, 1])
    radius = jnp.sqrt(half * half + s[:, 2] * s[:, 2] + 1e-20)
    high, low = jnp.maximum(mean + radius, 0.0), jnp.maximum(mean - radius, 0.0)
    centre, slope = 0.5 * (high + low), 0.5 * (high - low) / radius
    return jnp.stack([centre + slope * half, centre - slope * half, slope * s[:, 2]], axis=-1)


def principal_stretches(x: Float[Array, "V 3"], cloth: Cloth) -> Float[Array, "F 2"]:
    """Largest and smallest stretch of each face (1 = at rest), for strain maps and limits."""
    strain = green_strain(deformation_gradients(x, cloth))
    mean, half = strain[:, 0] + strain[:, 1] + 1, strain[:, 0] - strain[:, 1]
    radius = jnp.sqrt(half * half + strain[:, 2] * strain[:, 2] + 1e-20)
    return jnp.sqrt(jnp.maximum(jnp.stack([mean + radius, mean - radius], axis=-1), 0.0))
