"""From a triangle mesh to the padded graph that the networks run on; host side."""

from collections.abc import Sequence

import jax
import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tryon_jax.graph.buckets import bucket_for_levels
from tryon_jax.graph.coarsen import coarsen
from tryon_jax.graph.laplacian import Normalisation, scaled_laplacian
from tryon_jax.graph.operator import SparseOperator, make_operator
from tryon_jax.graph.pooling import Pooling, down_matrix, up_matrix
from tryon_jax.mesh.topology import unique_edges
from tryon_jax.types import ArrayLike, Body, pytree

NUM_LEVELS = 5
"""Levels of a hierarchy by default: the full graph and four halvings."""
_BLENDED = 8


@pytree
class GraphLevel:
    """One resolution of the pooling hierarchy."""

    laplacian: SparseOperator
    """L̃ = 2 L / λ_max − I; rows of padded nodes are empty."""
    down: SparseOperator | None
    """To the next coarser level; None on the coarsest."""
    up: SparseOperator | None
    """Back from the next coarser level; None on the coarsest."""
    mask: Bool[ArrayLike, "*batch N"]
    """True at real nodes."""


@pytree
class GarmentGraph:
    """A garment as the networks see it, padded to a size bucket; N nodes, of which the first `num_vertices` are real.

    Stacked along a leading axis by `stack_graphs` it is a batch of garments for `jax.vmap`.
    """

    levels: tuple[GraphLevel, ...]
    """Finest first; level l holds N / 2^l nodes."""
    vertices: Float[ArrayLike, "*batch N 3"]
    """Vertices on the mean body, metres; zero at padded nodes."""
    faces: Int[ArrayLike, "*batch F 3"]
    """Triangles, padded with (0, 0, 0) to F = 2 N."""
    skinning_weights: Float[ArrayLike, "*batch N J"]
    """Skinning weights of the closest body vertices on the mean body (`blend_skinning`); zero at padded nodes."""
    body_vertices: Int[ArrayLike, "*batch N"]
    """Closest vertex of the mean body; zero at padded nodes."""
    mask: Bool[ArrayLike, "*batch N"]
    """True at real nodes."""
    num_vertices: Int[ArrayLike, "*batch"]
    """Number of real nodes (an array, so that garments of one bucket share compiled code)."""

    @property
    def num_nodes(self) -> int:
        """The bucket size N."""
        return self.vertices.shape[-2]


def closest_body_vertices(vertices: Float[np.ndarray, "V 3"], body: Body) -> Int[np.ndarray, " V"]:
    """Closest vertex of the mean body."""
    return cKDTree(np.asarray(body.v_template)).query(vertices)[1]


def blend_skinning(vertices: Float[np.ndarray, "V 3"], body: Body) -> Float[np.ndarray, "V J"]:
    """Skinning weights near each vertex on the mean body, which describe the node (section 4.2 of the paper).

    The paper takes those of the closest body vertex. They jump where another one becomes the closest, so that rounding
    could move a drape; here the eight closest are blended by weights that fade to zero at the ninth's distance.
    """
    return _blend(vertices, body)[0]


def _blend(vertices: np.ndarray, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Blended skinning weights and the closest body vertex of each vertex, by one search."""
    count = min(_BLENDED + 1, len(body.v_template))
    distance, index = cKDTree(np.asarray(body.v_template)).query(vertices, k=np.arange(1, count + 1))
    blend = (1.0 - distance[:, :-1] / np.maximum(distance[:, -1:], 1e-12)) ** 2 + 1e-12
    blend /= blend.sum(axis=1, keepdims=True)
    skinning = np.asarray(body.lbs_weights).take(index[:, :-1], axis=0)
    return np.einsum("vk,vkj->vj", blend, skinning), index[:, 0]


def build_graph(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    body: Body,
    *,
    num_levels: int = NUM_LEVELS,
    pooling: Pooling = "average",
    bucket: int | None = None,
    pattern: Float[np.ndarray, "V 3"] | None = None,
    laplacian: Normalisation = "random-walk",
    levels: tuple[GraphLevel, ...] | None = None,
    dtype: np.dtype | type = np.float32,
) -> GarmentGraph:
    """Laplacians, pooling hierarchy and node features of a garment on the mean body, padded to a size bucket.

    Args:
        vertices: Metres, in the frame of the body.
        faces: Triangles; clean meshes coarsen to exactly half at each level, others as far as they can.
        body: Its mean shape and skinning weights describe the nodes.
        num_levels: Resolutions, the finest included.
        pooling: How coarse nodes gather features, see `down_matrix`.
        bucket: Number of nodes to pad to; chosen by `bucket_size` when None.
        pattern: The same vertices before draping, metres (`tryon_jax.garment.placement`): the pooling hierarchy is
            built from them, since the costs of edge collapses tie or nearly tie all over a garment, and the last bits
            of a predicted mean drape would choose between them. By default the vertices themselves.
        laplacian: Normalisation of the graph Laplacians.
        levels: Of a graph of the same faces, taken over in place of a hierarchy made anew.
        dtype: Of all floating-point arrays. The vertices are rounded to it before anything is built from them, so
            that equal graphs come from equal stored vertices.

    Raises:
        ValueError: there is no vertex, a face index is out of range, `bucket` is too small, or `levels` are of another
            number of vertices.
    """
    num_vertices = len(vertices)
    if num_vertices == 0 or len(faces) == 0:
        raise ValueError(f"a garment needs vertices and faces, got {num_vertices} vertices and {len(faces)} faces")
    if faces.min() < 0 or faces.max() >= num_vertices:
        raise ValueError(
            f"faces refer to vertex {faces.max()} (or {faces.min()}), but there are {num_vertices} vertices"
        )
    points = np.asarray(vertices, dtype).astype(np.float64)
    if levels is None:
        shape = points if pattern is None else np.asarray(pattern, np.float64)
        levels = _hierarchy(shape, np.asarray(faces, np.int64), num_levels, pooling, laplacian, bucket, dtype)
    elif int(np.asarray(levels[0].mask).sum()) != num_vertices:
        raise ValueError(f"levels are of {int(np.asarray(levels[0].mask).sum())} vertices, the mesh has {num_vertices}")
    size = len(np.asarray(levels[0].mask))
    capacity = 2 * size
    while capacity < len(faces):
        capacity *= 2
    skinning, closest = _blend(points, body)
    return GarmentGraph(
        levels=levels,
        vertices=pad_rows(points, size, dtype),
        faces=pad_rows(np.asarray(faces), capacity, np.int32),
        skinning_weights=pad_rows(skinning, size, dtype),
        body_vertices=pad_rows(closest, size, np.int32),
        mask=np.arange(size) < num_vertices,
        num_vertices=np.asarray(num_vertices, np.int32),
    )


def _hierarchy(
    points: np.ndarray,
    faces: np.ndarray,
    num_levels: int,
    pooling: Pooling,
    laplacian: Normalisation,
    bucket: int | None,
    dtype: np.dtype | type,
) -> tuple[GraphLevel, ...]:
    laplacians, downs, ups = [], [], []
    for level in range(num_levels):
        edges, _ = unique_edges(faces, len(points))
        laplacians.append(scaled_laplacian(edges, len(points), laplacian)[0])
        if level + 1 < num_levels:
            coarse = coarsen(points, faces)
            down = down_matrix(coarse, pooling)
            # Coarse features are located where the down matrix puts them: at the means of the clusters, if it averages.
            ups.append(up_matrix(points, down @ points, coarse.faces, coarse.cluster))
            downs.append(down)
            points, faces = points[coarse.kept], coarse.faces
    sizes = [matrix.shape[0] for matrix in laplacians]
    needed = bucket_for_levels(sizes)
    size = bucket or needed
    if any(n > size >> level for level, n in enumerate(sizes)) or size % (1 << (num_levels - 1)):
        raise ValueError(f"bucket = {size} does not hold levels of {sizes} nodes; use {needed}")
    return tuple(
        _pad_level(
            laplacians[i], downs[i] if i < len(downs) else None, ups[i] if i < len(ups) else None, size >> i, dtype
        )
        for i in range(num_levels)
    )


def pad_rows(array: np.ndarray, size: int, dtype: np.dtype | type) -> np.ndarray:
    """The array with zero rows added up to `size`.

    Args:
        array: Rows.
        size: Number of rows of the result, at least those of `array`.
        dtype: Type of the result.
    """
    padded = np.zeros((size, *array.shape[1:]), dtype)
    padded[: len(array)] = array
    return padded


def _pad_level(
    laplacian: sp.csr_array,
    down: sp.csr_array | None,
    up: sp.csr_array | None,
    size: int,
    dtype: np.dtype | type,
) -> GraphLevel:
    """Capacities that every mesh of the library fits (seven neighbours apart from few); others grow them."""
    half = size // 2
    tail = (max(size // 8, 1), 4)
    return GraphLevel(
        laplacian=make_operator(
            laplacian,
            (size, size),
            slots=7,
            tail=tail,
            transposed_slots=7,
            transposed_tail=tail,
            split_diagonal=True,
            dtype=dtype,
        ),
        down=None
        if down is None
        else make_operator(down, (half, size), slots=4, tail=(max(half // 8, 1), 4), transposed_slots=1, dtype=dtype),
        up=None
        if up is None
        else make_operator(
            up, (size, half), slots=3, transposed_slots=8, transposed_tail=(max(half // 4, 1), 16), dtype=dtype
        ),
        mask=np.arange(size) < laplacian.shape[0],
    )


def stack_graphs(graphs: Sequence[GarmentGraph]) -> GarmentGraph:
    """Garments of one bucket as one pytree with a leading axis, for `jax.vmap` over garments.

    Raises:
        ValueError: the garments are padded to different sizes.
    """
    shapes = {jax.tree.structure(g): None for g in graphs}
    sizes = sorted({g.num_nodes for g in graphs})
    if len(sizes) != 1 or len(shapes) != 1:
        raise ValueError(f"graphs of different buckets cannot be stacked: {sizes}; build them with one `bucket`")
    return jax.tree.map(lambda *arrays: np.stack([np.asarray(a) for a in arrays]), *graphs)
