"""Lengths of a draped garment, differentiable: girths of its torso where tapes are laid, and the height of its hem."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.garment import GarmentMesh
from tryon_jax.tryon import Garment
from tryon_jax.types import ArrayLike, Body, pytree

_ARM = ("shoulder", "elbow", "wrist", "hand")


@pytree
class Tapes:
    """What a garment's lengths are read from: its torso, its hem, and the planes of G tapes."""

    faces: Int[ArrayLike, "F 3"]
    torso: Bool[ArrayLike, " F"]
    """Faces that a tape round the body may cross; those of sleeves are none of them."""
    hem: Bool[ArrayLike, " N"]
    """Vertices of the hem."""
    points: Float[ArrayLike, "G 3"]
    """One in the plane of each tape, metres."""
    normals: Float[ArrayLike, "G 3"]
    ground: Float[ArrayLike, ""]
    """Height of the soles, metres."""


def make_tapes(
    garment: Garment,
    mesh: GarmentMesh,
    body: Body,
    places: Sequence[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]],
    ground: float,
) -> Tapes:
    """The tapes of one garment on one body, padded like the garment.

    Args:
        garment: Prepared from `mesh`.
        mesh: Has the hem.
        body: Whose joints tell sleeves from torso.
        places: Point and normal of the plane of each tape, from `wear.fit.tape_place`.
        ground: Height of the soles, metres.
    """
    arms = [k for k, name in enumerate(body.joint_names) if name.split("_")[-1] in _ARM]
    graph = garment.graph
    sleeve = np.asarray(graph.skinning_weights)[:, arms].sum(axis=1) > 0.5
    faces = np.asarray(graph.faces)
    hem = np.zeros(graph.num_nodes, bool)
    hem[np.asarray(mesh.loops["hem"])] = True
    points, normals = (np.stack([place[k] for place in places]).astype(np.float32) for k in (0, 1))
    torso = faces.any(axis=1) & ~sleeve[faces].any(axis=1)
    return Tapes(faces, torso, hem, points, normals, np.asarray(ground, np.float32))


def girths_and_hem(tapes: Tapes, vertices: Float[Array, "N 3"]) -> Float[Array, " L"]:
    """Length of the torso's cloth in the plane of each tape, then the hem's mean height over the ground; metres.

    Each face that a plane cuts adds the length of the cut: differentiable wherever no vertex lies in the plane. A tape
    that the garment does not reach has no length.

    Args:
        tapes: From `make_tapes`.
        vertices: The drape, padded, metres.
    """
    corners = vertices[jnp.asarray(tapes.faces)]
    girth = jax.vmap(lambda point, normal: _cut_length(corners, jnp.asarray(tapes.torso), point, normal))(
        jnp.asarray(tapes.points), jnp.asarray(tapes.normals)
    )
    hem = jnp.asarray(tapes.hem)
    height = jnp.where(hem, vertices[:, 1], 0.0).sum() / hem.sum() - tapes.ground
    return jnp.concatenate([girth, height[None]])


def _cut_length(
    corners: Float[Array, "F 3 3"], counted: Bool[Array, " F"], point: Float[Array, "3"], normal: Float[Array, "3"]
) -> Float[Array, ""]:
    low = jnp.einsum("fkc,c->fk", corners - point[None, None], normal)
    high, following = jnp.roll(low, -1, axis=1), jnp.roll(corners, -1, axis=1)
    cut = (low >= 0) != (high >= 0)
    fraction = low / jnp.where(cut, low - high, 1.0)
    points = corners + fraction[..., None] * (following - corners)
    total = jnp.zeros((), corners.dtype)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        both = cut[:, first] & cut[:, second] & counted
        squared = ((points[:, first] - points[:, second]) ** 2).sum(axis=1)
        # The root's slope is infinite at zero, where faces that are not cut are.
        total = total + jnp.where(both, jnp.sqrt(jnp.where(both, squared + 1e-12, 1.0)), 0.0).sum()
    return total
