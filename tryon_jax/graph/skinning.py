"""Skinning weights by which a garment follows the joints of a body."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tryon_jax.graph.build import closest_body_vertices
from tryon_jax.mesh.topology import unique_edges
from tryon_jax.types import Body

_ROUNDS = 40


def garment_skinning(
    mean_vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], body: Body
) -> Float[np.ndarray, "V J"]:
    """Skinning weights of a garment: those of the nearest skin, averaged over neighbours; rows sum to 1.

    Args:
        mean_vertices: The garment on the mean body in T-pose, metres.
        faces: Its triangles.
        body: The body.
    """
    return soft_skinning(np.asarray(body.lbs_weights)[closest_body_vertices(mean_vertices, body)], faces)


def soft_skinning(
    weights: Float[np.ndarray, "V J"], faces: Int[np.ndarray, "F 3"], rounds: int = _ROUNDS
) -> Float[np.ndarray, "V J"]:
    """Skinning weights of a garment, averaged over neighbours; rows still sum to 1.

    Weights of the closest body vertex jump where the closest limb changes, as in the middle of a skirt: skinned with
    them the cloth would tear between the legs.

    Args:
        weights: Skinning weights of each vertex; rows sum to 1.
        faces: Triangles.
        rounds: How often to average.
    """
    edges, _ = unique_edges(faces, len(weights))
    both = np.concatenate([edges, edges[:, ::-1]])
    links = sp.coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(len(weights), len(weights))).tocsr()
    count = np.maximum(links.sum(axis=1), 1)
    soft = np.asarray(weights, np.float64)
    for _ in range(rounds):
        soft = 0.5 * soft + 0.5 * (links @ soft) / count[:, None]
    return soft / np.maximum(soft.sum(axis=1, keepdims=True), 1e-12)
