"""Laplacian smoothing with a length in metres: heat flow on the surface, along the border only on the border.

A number of umbrella steps smooths less the finer the mesh is. Here x is replaced by exp(−t A) x, the heat flow after
time t = length², where A is the cotangent Laplacian in the metric of the mean drape (Pinkall and Polthier 1993)
inside, and the Laplacian of a curve at border vertices, so that hems and cuffs keep their outline and do not shrink
into the garment. The exponential is a Chebyshev polynomial in A with fixed length: the same few sparse products on
the host and on the device, linear and therefore differentiable.
"""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float, Int
from scipy.special import ive

from tryon_jax.graph.operator import SparseOperator, apply_operator, make_operator
from tryon_jax.mesh.topology import border_edges
from tryon_jax.types import ArrayLike, pytree

_ERROR = 1e-5
# Values outside these bounds come from the mesh and not from the surface: slivers would make the flow stiff.
_WEIGHT_RANGE = (0.02, 4.0)
_MIN_MASS = 0.2


@pytree
class HeatSmoother:
    """exp(−length² A) as a polynomial; padded rows give zero."""

    operator: SparseOperator
    """2 A / λ − I with λ a bound of A's spectrum."""
    coefficients: Float[ArrayLike, "*batch K"]
    """Chebyshev coefficients, zero where not needed."""


def surface_laplacian(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> tuple[sp.csr_array, float]:
    """A with (A x)_i ≈ −Δx in 1/m² and a bound of its spectrum; border rows see the border only.

    Edge weights and vertex areas are clipped to what well-shaped triangles have.
    """
    n = len(vertices)
    corners = vertices[faces]
    rows, columns, values = [], [], []
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        to_i, to_j = corners[:, i] - corners[:, k], corners[:, j] - corners[:, k]
        cotangent = np.einsum("fc,fc->f", to_i, to_j) / np.maximum(2.0 * area, 1e-12)
        rows += [faces[:, i], faces[:, j]]
        columns += [faces[:, j], faces[:, i]]
        values += [0.5 * cotangent, 0.5 * cotangent]
    mass = np.bincount(faces.ravel(), np.repeat(area / 3.0, 3), minlength=n)
    border = border_edges(faces, n)
    on_border = np.zeros(n, bool)
    on_border[border] = True
    index = (np.concatenate(rows), np.concatenate(columns))
    weights = sp.coo_array((np.concatenate(values), index), shape=(n, n)).tocsr().tocoo()
    # The two cotangents at an edge are clipped together: one of them is negative beside any obtuse angle.
    (row, column), value = weights.coords, np.clip(weights.data, *_WEIGHT_RANGE)
    inside = ~on_border[row]
    length = np.linalg.norm(vertices[border[:, 0]] - vertices[border[:, 1]], axis=1)
    length = np.maximum(length, 0.2 * length.mean() if len(length) else 0.0)
    curve_mass = np.bincount(border.ravel(), np.repeat(0.5 * length, 2), minlength=n)
    row = np.concatenate([row[inside], border[:, 0], border[:, 1]])
    column = np.concatenate([column[inside], border[:, 1], border[:, 0]])
    value = np.concatenate([value[inside], 1.0 / length, 1.0 / length])
    positive = mass[mass > 0]
    mass = np.maximum(mass, _MIN_MASS * (np.median(positive) if len(positive) else 1.0))
    mass = np.where(on_border, np.maximum(curve_mass, 1e-12), mass)
    weights = sp.coo_array((value / mass[row], (row, column)), shape=(n, n)).tocsr()
    total = weights.sum(axis=1)
    laplacian = (sp.diags_array(total) - weights).tocsr()
    # Gershgorin: the row sums of the absolute values are twice the diagonal.
    return laplacian, float(2.0 * total.max(initial=0.0))


def heat_coefficients(time: float, bound: float) -> Float[np.ndarray, " K"]:
    """Chebyshev coefficients of exp(−time · λ) for λ in [0, bound]; K is 32, 64 …, the rest below 1e-5."""
    half = 0.5 * time * bound
    # Garments of the usual density need 16 to 32: one length for all keeps their compiled code the same.
    count = 32
    # exp(−half (1 + x)) = Σ (2 − δ_k0) (−1)^k e^{−half} I_k(half) T_k(x).
    while ive(count, half) > _ERROR * 0.1:
        count *= 2
    k = np.arange(count)
    return np.where(k == 0, 1.0, 2.0) * (-1.0) ** k * ive(k, half)


def make_smoother(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    length: float,
    size: int | None = None,
    dtype: np.dtype | type = np.float32,
) -> HeatSmoother:
    """Smoothing over `length` metres on a garment, padded to `size` vertices; host side.

    Args:
        vertices: Metres.
        faces: Triangles.
        length: Metres over which a detail is smoothed away.
        size: Vertices with padding; no padding when None.
        dtype: Of the matrices.
    """
    n = len(vertices)
    size = n if size is None else size
    laplacian, bound = surface_laplacian(np.asarray(vertices, np.float64), np.asarray(faces, np.int64))
    scaled = (laplacian * (2.0 / max(bound, 1e-12)) - sp.eye_array(n)).tocsr()
    tail = (max(size // 8, 1), 4)
    operator = make_operator(
        scaled, (size, size), slots=8, tail=tail, transposed_slots=8, transposed_tail=tail, dtype=dtype
    )
    return HeatSmoother(operator, heat_coefficients(length**2, bound).astype(dtype))


def smooth(smoother: HeatSmoother, values: Float[Array, " N *rest"]) -> Float[Array, " N *rest"]:
    """exp(−length² A) applied to positions or displacements at the vertices; constants are kept."""
    coefficients = jnp.asarray(smoother.coefficients, values.dtype)
    before, now = values, apply_operator(smoother.operator, values)
    total = coefficients[0] * before + coefficients[1] * now

    # A loop and not a long row of products: the same numbers, and a quarter of the time to compile.
    def term(carry: tuple[Array, Array, Array], coefficient: Array) -> tuple[tuple[Array, Array, Array], None]:
        before, now, total = carry
        after = 2.0 * apply_operator(smoother.operator, now) - before
        return (now, after, total + coefficient * after), None

    return jax.lax.scan(term, (before, now, total), coefficients[2:])[0][2]
