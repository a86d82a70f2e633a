"""The rest state of a cloth: what the energies need to know of its mesh, once per mesh, independent of fabric.

Built on the host from a welded triangle mesh with UV rest coordinates (metres). Arrays are padded to a size bucket so
that another mesh of the bucket runs without compiling anything.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from tryon_jax.checks import check_finite
from tryon_jax.mesh.topology import components
from tryon_jax.mesh.topology import hinges as find_hinges
from tryon_jax.physics.incidence import Incidence, find_incidence
from tryon_jax.physics.patches import Patches, make_patches
from tryon_jax.types import ArrayLike, pytree

BUCKET = 512
"""Vertex counts are padded to a multiple of this."""


@pytree
class Cloth:
    """Rest state and sparsity of a cloth of V vertices (padding included), F faces and H hinges."""

    faces: Int[ArrayLike, "F 3"]
    shape_gradients: Float[ArrayLike, "F 3 2"]
    """Derivative of each corner's hat function with respect to (u, v), 1/m; zero for padding."""
    face_areas: Float[ArrayLike, " F"]
    """Rest areas, m²; zero for padding."""
    hinges: Int[ArrayLike, "H 4"]
    """Edge (a, b) and the vertices opposite to it in its two faces."""
    hinge_shape: Float[ArrayLike, " H"]
    """l² / (4 (A0 + A1)) with rest edge length and rest areas; zero for padding."""
    hinge_curvature: Float[ArrayLike, " H"]
    """l / (2 (A0 + A1)), 1/m: the measure α of the bending tables is this times the dihedral angle."""
    hinge_grain: Float[ArrayLike, "H 2"]
    """Angle of the hinge edge from the warp in its two faces, radians in [0, π/2]."""
    vertex_areas: Float[ArrayLike, " V"]
    """A third of the rest area of the adjacent faces, m²; zero for padding."""
    active: Float[ArrayLike, " V"]
    """1 for vertices of the mesh, 0 for padding."""
    incidence: Incidence
    """Which faces and hinges add to each vertex and each block of the system matrix."""
    patches: Patches
    """For the linear solver."""


def build_cloth(
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "U 2"],
    faces_uv: Int[np.ndarray, "F 3"],
    num_vertices: int,
    bucket: int = BUCKET,
    dtype: type = np.float32,
) -> Cloth:
    """Rest state from a welded mesh and its flat panels.

    Args:
        faces: triangles over the welded vertices.
        uv: panel coordinates, metres; both sides of a seam have their own.
        faces_uv: index into `uv` for each corner of each face.
        num_vertices: number of welded vertices V.
        bucket: V is padded to a multiple of this, F and H in proportion.
        dtype: floating type of the result.

    Raises:
        ValueError: NaN in `uv`, a face with (nearly) no rest area or turned over within its panel.
    """
    corners = check_finite("uv", np.asarray(uv, float))[faces_uv]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1)
    determinants = np.linalg.det(edges)
    areas = 0.5 * np.abs(determinants)
    flat = np.flatnonzero(areas < 1e-4 * (edges**2).sum((1, 2)))
    if len(flat):
        raise ValueError(
            f"face {flat[0]} has rest area {areas[flat[0]]:.3g} m²: inverted or degenerate ({len(flat)} such)"
        )
    _check_orientation(determinants > 0, faces_uv, len(uv))
    inverse = np.linalg.inv(edges)
    gradients = np.stack([-(inverse[:, 0] + inverse[:, 1]), inverse[:, 0], inverse[:, 1]], axis=1)

    hinges, pairs = find_hinges(faces, num_vertices)
    lengths, grains = _hinge_rest(faces, corners, hinges, pairs)
    hinge_area = areas[pairs].sum(axis=1)

    padded_v = -(-num_vertices // bucket) * bucket
    padded_f, padded_h = 2 * padded_v, 3 * padded_v

    def fill(array: np.ndarray, size: int, value: float, spare: int = 0) -> np.ndarray:
        # Indices of elements that are not there name the last one: it must be padding.
        if len(array) + spare > size:
            raise ValueError(f"mesh with {len(array)} entries does not fit its bucket of {size}")
        # A lone triangle has no hinge to repeat.
        row = array[:1] * value if len(array) else np.zeros((1, *array.shape[1:]), array.dtype)
        return np.concatenate([array, np.broadcast_to(row, (size - len(array), *array.shape[1:]))])

    def pad(array: np.ndarray, size: int, kind: type) -> jnp.ndarray:
        return jnp.asarray(fill(array, size, 0).astype(kind))

    def pad_index(array: np.ndarray, size: int) -> jnp.ndarray:
        return jnp.asarray(fill(array, size, 1, spare=1).astype(np.int32))

    vertex_areas = np.bincount(faces.ravel(), np.repeat(areas / 3, 3), num_vertices)
    return Cloth(
        faces=pad_index(faces, padded_f),
        shape_gradients=pad(gradients, padded_f, dtype),
        face_areas=pad(areas, padded_f, dtype),
        hinges=pad_index(hinges, padded_h),
        hinge_shape=pad(lengths**2 / (4 * hinge_area), padded_h, dtype),
        hinge_curvature=pad(lengths / (2 * hinge_area), padded_h, dtype),
        hinge_grain=pad(grains, padded_h, dtype),
        vertex_areas=pad(vertex_areas, padded_v, dtype),
        active=pad(np.ones(num_vertices), padded_v, dtype),
        incidence=find_incidence(np.asarray(faces), hinges, padded_v, padded_f, padded_h),
        patches=_patches(np.asarray(faces), np.asarray(uv, float), np.asarray(faces_uv), num_vertices, padded_v),
    )


def _patches(faces: np.ndarray, uv: np.ndarray, faces_uv: np.ndarray, num_vertices: int, padded: int) -> Patches:
    """Patches by flat place; a vertex on a seam counts to one of its panels."""
    corner = np.zeros(num_vertices, int)
    corner[faces.ravel()] = faces_uv.ravel()
    return make_patches(uv[corner], components(faces_uv, len(uv))[1][corner], padded)


def _check_orientation(left: np.ndarray, faces_uv: np.ndarray, num_uv: int) -> None:
    """Panels may be drawn mirrored, each as a whole: a face that turns the other way is folded over in the plane."""
    panel = components(faces_uv, num_uv)[1][faces_uv[:, 0]]
    faces_of, left_of = np.bincount(panel), np.bincount(panel, left)
    wrong = np.flatnonzero(left != (2 * left_of > faces_of)[panel])
    if len(wrong):
        raise ValueError(f"face {wrong[0]} is inverted at rest: it turns against its panel ({len(wrong)} such)")


def _hinge_rest(
    faces: np.ndarray, corners: np.ndarray, hinges: np.ndarray, pairs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rest edge length (mean of the two sides: they differ only where a seam is eased) and grain angle on each side."""

    def rest(face: np.ndarray, vertex: np.ndarray) -> np.ndarray:
        return corners[face, np.argmax(faces[face] == vertex[:, None], axis=1)]

    vectors = [rest(pairs[:, side], hinges[:, 1]) - rest(pairs[:, side], hinges[:, 0]) for side in (0, 1)]
    lengths = 0.5 * sum(np.linalg.norm(vector, axis=1) for vector in vectors)
    grains = np.stack([np.arctan2(np.abs(vector[:, 1]), np.abs(vector[:, 0])) for vector in vectors], axis=1)
    return np.asarray(lengths), grains
