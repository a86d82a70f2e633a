"""Clothes of MakeHuman on an embedded body, by their own binding: no unit, place or pose has to be found."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tryon_jax.body.makehuman import BASE_MESH, base_mesh_points
from tryon_jax.mesh.mhclo import read_binding
from tryon_jax.mesh.reading import read_triangles
from tryon_jax.types import Body

SUFFIX = ".mhclo"


def read_bound(
    path: str | Path, body: Body
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"], Float[np.ndarray, "V 2"] | None]:
    """Triangles of a bound garment, on the mean shape of `body` in T-pose.

    Args:
        path: The .mhclo file; its OBJ file lies beside it.
        body: An embedded body.

    Returns:
        Vertices (metres), faces, and texture coordinates where the OBJ file has them.

    Raises:
        FileNotFoundError: The file or its OBJ file is missing.
        ValueError: The garment is bound to another mesh, or to another number of vertices than the OBJ file has.
    """
    binding = read_binding(path)
    if binding.base_mesh != BASE_MESH:
        raise ValueError(f"garment {str(path)!r} is bound to {binding.base_mesh!r}; known: {BASE_MESH}")
    vertices, faces, uv = read_triangles(binding.mesh)
    lines = binding.mesh.read_text(encoding="utf-8", errors="replace").splitlines()
    listed = np.array([line.split()[1:4] for line in lines if line.startswith(("v ", "v\t"))], float)
    if len(listed) != len(binding.corners):
        raise ValueError(
            f"garment {str(path)!r} binds {len(binding.corners)} vertices, but {binding.mesh.name} has {len(listed)}"
        )
    # The reader splits vertices at seams of the texture: each is known by its position.
    return binding.vertices(base_mesh_points(body))[cKDTree(listed).query(vertices)[1]], faces, uv
