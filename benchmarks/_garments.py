"""Garments of any size for the comparison: as meshed by the library, and for finer ones each triangle cut into four."""

from dataclasses import dataclass
from functools import cache

import jax
import numpy as np

from tryon_jax.body import load_body
from tryon_jax.garment import load_design_space, placement, remesh
from tryon_jax.graph import build_graph
from tryon_jax.graph.laplacian import Normalisation
from tryon_jax.graph.pooling import Pooling
from tryon_jax.graph.smoothing import make_smoother
from tryon_jax.mesh.topology import edge_keys
from tryon_jax.nets import TryOnConfig
from tryon_jax.tryon import Garment, TryOnModel, init_model, load_pretrained, prepare

LARGEST_MESHED = 6000
"""Garments with more vertices are subdivided ones: meshing 100,000 vertices would take longer than measuring them."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A garment's mesh on the mean body and flat."""

    mean: np.ndarray
    """M̄ of the pretrained model, metres."""
    start: np.ndarray
    """Placed around the body before dressing, metres."""
    faces: np.ndarray
    uv: np.ndarray
    faces_uv: np.ndarray


def subdivide(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every triangle cut into four at the middles of its edges."""
    n = len(vertices)
    half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, first, edge = np.unique(edge_keys(np.sort(half, axis=1), n), return_index=True, return_inverse=True)
    ab, bc, ca = (n + edge.reshape(3, -1)).astype(faces.dtype)
    a, b, c = faces.T
    cut = [np.stack(f, axis=1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate([vertices, vertices[half[first]].mean(axis=1)]), np.concatenate(cut)


@cache
def mesh_of_size(vertices: int) -> Mesh:
    """A garment with about this many vertices: a tank for the smallest, else a maxi dress."""
    model, space = load_pretrained(), load_design_space()
    design = space.preset("tank" if vertices < 2000 else "maxi-dress")
    cuts = 0
    while vertices / 4**cuts > LARGEST_MESHED:
        cuts += 1
    wanted, area = vertices / 4**cuts, model.config.target_area
    for _ in range(3):
        mesh = remesh(space, design, area)
        if abs(mesh.num_vertices / wanted - 1) < 0.01:
            break
        area *= mesh.num_vertices / wanted
    mean = prepare(model, design, target_area=area).mean_vertices
    start, faces, uv, faces_uv = placement(mesh), mesh.faces, mesh.uv, mesh.faces_uv
    for _ in range(cuts):
        mean = subdivide(mean, faces)[0]
        (start, finer), (uv, faces_uv) = subdivide(start, faces), subdivide(uv, faces_uv)
        faces = finer
    return Mesh(mean, start, faces, uv, faces_uv)


@cache
def model_of(config: TryOnConfig | None) -> TryOnModel:
    """The pretrained model in the paper's form for None, else one with random weights."""
    return load_pretrained("paper-form") if config is None else init_model(jax.random.key(0), config, body=load_body())


def garment_of(config: TryOnConfig, vertices: int) -> Garment:
    """Graph and smoother of the mesh of this size."""
    return _garment(vertices, config.body, config.num_levels, config.pooling, config.laplacian, config.smoothing_length)


@cache
def _garment(
    vertices: int, body: str, levels: int, pooling: Pooling, laplacian: Normalisation, length: float
) -> Garment:
    # Networks of all sizes share a graph: one of 100,000 vertices takes half a minute.
    mesh = mesh_of_size(vertices)
    return garment_of_mesh(mesh.mean, mesh.faces, body, levels, pooling, laplacian, length)


def garment_of_mesh(
    mean: np.ndarray,
    faces: np.ndarray,
    body: str,
    levels: int,
    pooling: Pooling,
    laplacian: Normalisation,
    length: float,
) -> Garment:
    """Graph and smoother of a mesh on the mean body."""
    graph = build_graph(mean, faces, load_body(body), num_levels=levels, pooling=pooling, laplacian=laplacian)
    return Garment(graph, make_smoother(mean, faces, length, graph.num_nodes))
