"""MakeHuman's base mesh hm08 on the embedded bodies, which were made from it: for clothes that are bound to it."""

import numpy as np
from jaxtyping import Float

from tryon_jax.body.embedded import NUM_VERTICES, read_asset
from tryon_jax.body.normals import vertex_normals
from tryon_jax.types import Body

BASE_MESH = "hm08"
"""Name of the mesh in the files of clothes."""


def base_mesh_points(body: Body) -> Float[np.ndarray, "N 3"]:
    """Vertices of the base mesh, its helpers too, on the mean shape of an embedded body in T-pose.

    Args:
        body: From `load_body`.

    Returns:
        Positions, metres. A helper lies over the point of the skin that it was nearest to, as high as it was.

    Raises:
        ValueError: The body has another topology.
    """
    faces = np.asarray(body.faces)
    if len(body.v_template) != NUM_VERTICES or not np.array_equal(faces, read_asset("topology", ["faces"])["faces"]):
        raise ValueError(
            f"body {body.name!r} is not one of the embedded bodies, which alone have MakeHuman's base mesh"
        )
    asset = read_asset("makehuman")
    first = asset["weights"].astype(np.float64)
    weights = np.concatenate([first, 1.0 - first.sum(axis=1, keepdims=True)], axis=1)
    corners = faces[asset["face"]]
    vertices = np.asarray(body.v_template, np.float64)
    normals = np.asarray(vertex_normals(body.v_template, body.faces), np.float64)
    normal = np.einsum("nk,nkc->nc", weights, normals[corners])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    on_skin = np.einsum("nk,nkc->nc", weights, vertices[corners])
    return on_skin + asset["height"].astype(np.float64)[:, None] * normal
