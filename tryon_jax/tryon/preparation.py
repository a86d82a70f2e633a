"""Host side, once per design: from a pattern or a user's mesh to a `Garment` (NumPy and SciPy)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tryon_jax.checks import check_finite
from tryon_jax.garment import Design, DesignSpace, GarmentMesh, place_on_template, placement, remesh
from tryon_jax.garment.pattern_map import map_patterns, pattern_arrays
from tryon_jax.graph.buckets import bucket_size
from tryon_jax.graph.build import build_graph, pad_rows
from tryon_jax.graph.resample import resample
from tryon_jax.graph.smoothing import make_smoother
from tryon_jax.mesh.closest_points import MeshSearch
from tryon_jax.mesh.loaded_garment import LoadedGarment
from tryon_jax.mesh.quality import edge_lengths
from tryon_jax.mesh.reading import load_garment
from tryon_jax.mesh.repair import repair_mesh
from tryon_jax.mesh.stretch_limit import rest_edges
from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.tryon.garment import CarriedMesh, Garment
from tryon_jax.tryon.model import TryOnModel, config_space

# One small program: op by op, JAX compiles each by itself.
_apply_mean_drape = jax.jit(apply_mean_drape)
# A user's mesh is taken as it is when its mean triangle area is within this factor of what the networks know.
_DENSITY_RANGE = 1.6
# Half of the vertices of the widest simulated dress are within 0.03 m of the closest body vertex.
_MAX_MEDIAN_DISTANCE = 0.12


def prepare(
    model: TryOnModel,
    design: Design | Mapping[str, float] | Sequence[float] | str | None = None,
    *,
    mesh: str | Path | LoadedGarment | tuple[np.ndarray, np.ndarray] | None = None,
    seed: int = 0,
    target_area: float | None = None,
    bucket: int | None = None,
) -> Garment:
    """Make a garment ready to drape: pattern, topology optimisation, mean drape, graph (host side, once per design).

    Args:
        model: The model that will drape it.
        design: Parameters in metres by name (others take their means) or in order, the name of a preset, or a
            `Design`; None for the mean design.
        mesh: In place of a design: a mesh of the user's own as it hangs on the mean body (a file, what
            `load_garment` returned, or vertices and faces). It is repaired, and where its triangles are far from what
            the networks know, an evenly spaced copy is draped and carries the user's own vertices.
        seed: Another seed gives another topology.
        target_area: Mean area of the triangles, square metres; by default what the networks were trained on. A mesh
            of another density is carried by one of that density (see `prepare_mesh`).
        bucket: Number of nodes to pad to, see `build_graph`.

    Raises:
        ValueError: for unknown or out-of-range parameters, a design and a mesh at once, a mesh that cannot be
            repaired (see `load_garment`) or is not near the mean body.
        FileNotFoundError: there is no such mesh file.
    """
    area = model.config.target_area if target_area is None else target_area
    if mesh is not None:
        if design is not None:
            raise ValueError("prepare takes a design or a mesh, not both")
        return _prepare_own(model, _load_own(mesh), area, bucket)
    space = config_space(model.config)
    return prepare_mesh(model, remesh(space, design_of(space, design), area, seed=seed), bucket=bucket)


def prepare_mesh(
    model: TryOnModel,
    mesh: GarmentMesh,
    *,
    vertices: Float[np.ndarray, "V 3"] | None = None,
    bucket: int | None = None,
    near: Garment | None = None,
) -> Garment:
    """As `prepare`, for a garment mesh of φ that exists already (as in training sets).

    A filter of the networks reaches a number of edges, not of metres. The networks therefore see an even mesh of the
    density that they were trained on. A much finer or coarser mesh moves with it, through the flat pattern.

    Args:
        model: The model that will drape it.
        mesh: Topology and its tie to the template.
        vertices: M̄ in metres, which the networks then see as it is; by default W · R_mean(p).
        bucket: Number of nodes to pad to.
        near: A garment of the same faces, whose pooling hierarchy is taken over (see `garment.near_design`).
    """
    config = model.config
    design = np.asarray(mesh.design.values, np.float32)
    if vertices is None:
        points = _mean_vertices(model, mesh)
        if not _is_known(mesh.target_area, config.target_area):
            return _carried_by_the_pattern(model, mesh, points, bucket)
    else:
        points = check_finite("garment vertices", np.asarray(vertices))
    graph = build_graph(
        points,
        mesh.faces,
        model.body,
        num_levels=config.num_levels,
        pooling=config.pooling,
        bucket=bucket,
        pattern=None if near is not None else placement(mesh),
        laplacian=config.laplacian,
        levels=None if near is None else near.graph.levels,
    )
    size = graph.num_nodes
    template_vertices = np.zeros((size, 3), np.int32)
    template_weights = np.zeros((size, 3), np.float32)
    template_vertices[: len(points)] = mesh.template_vertices
    template_weights[: len(points)] = mesh.template_weights
    edges, rest = padded_edges(mesh.faces, edge_lengths(mesh.uv, mesh.faces_uv), len(points), size)
    smoother = make_smoother(points, mesh.faces, config.smoothing_length, size)
    return Garment(graph, smoother, design, template_vertices, template_weights, edges=edges, rest=rest)


def padded_edges(
    faces: Int[np.ndarray, "F 3"], lengths: Float[np.ndarray, "F 3"], num_vertices: int, size: int
) -> tuple[Int[np.ndarray, "E 2"], Float[np.ndarray, " E"]]:
    """`edges` and `rest` of a `Garment`.

    Args:
        faces: Triangles of the graph's mesh.
        lengths: Of the edges 0→1, 1→2 and 2→0 of each face at rest, metres.
        num_vertices: Of the mesh.
        size: Nodes of the graph.
    """
    edges, rest = rest_edges(faces, lengths, num_vertices)
    capacity = 3 * size
    while capacity < len(edges):
        capacity *= 2
    padded = np.ones(capacity, np.float32)
    padded[: len(rest)] = rest
    return pad_rows(edges, capacity, np.int32), padded


def _mean_vertices(model: TryOnModel, mesh: GarmentMesh) -> Float[np.ndarray, "V 3"]:
    """M̄ = W · R_mean(p), metres."""
    design = jnp.asarray(mesh.design.values, jnp.float32)
    return place_on_template(mesh, np.asarray(_apply_mean_drape(model.mean, design)))


def _is_known(area: float, trained: float) -> bool:
    """Whether triangles of that mean area are within the range of those that the networks were trained on."""
    return trained / _DENSITY_RANGE <= area <= trained * _DENSITY_RANGE


def _carried_by_the_pattern(
    model: TryOnModel, mesh: GarmentMesh, vertices: Float[np.ndarray, "V 3"], bucket: int | None
) -> Garment:
    even = remesh(config_space(model.config), mesh.design, model.config.target_area, seed=mesh.seed)
    onto = map_patterns(pattern_arrays(mesh), pattern_arrays(even))
    own = _carried_mesh(vertices, mesh.faces, onto.corners, onto.weights)
    return replace(prepare_mesh(model, even, bucket=bucket), own=own)


def _carried_mesh(
    vertices: Float[np.ndarray, "M 3"],
    faces: Int[np.ndarray, "G 3"],
    carriers: Int[np.ndarray, "M 3"],
    weights: Float[np.ndarray, "M 3"],
) -> CarriedMesh:
    size = bucket_size(len(vertices))
    return CarriedMesh(
        vertices=pad_rows(vertices, size, np.float32),
        faces=pad_rows(faces, max(2 * size, len(faces)), np.int32),
        carriers=pad_rows(carriers, size, np.int32),
        weights=pad_rows(weights, size, np.float32),
        num_vertices=np.asarray(len(vertices), np.int32),
    )


def design_of(space: DesignSpace, design: Design | Mapping[str, float] | Sequence[float] | str | None) -> Design:
    """The design given by parameters in metres by name or in order, by the name of a preset, or by None: the mean.

    Raises:
        ValueError: Unknown names, or values out of range.
    """
    if design is None:
        return space.mean_design
    if isinstance(design, Design):
        return space.design(design.label, **design.as_dict())
    if isinstance(design, str):
        return space.preset(design)
    if isinstance(design, Mapping):
        return space.design("", **design)
    return space.from_values(np.asarray(design, float))


def _load_own(mesh: str | Path | LoadedGarment | tuple[np.ndarray, np.ndarray]) -> LoadedGarment:
    if isinstance(mesh, LoadedGarment):
        return mesh
    if isinstance(mesh, tuple):
        return repair_mesh(np.asarray(mesh[0], float), np.asarray(mesh[1]))
    return load_garment(mesh)


def _prepare_own(model: TryOnModel, loaded: LoadedGarment, area: float, bucket: int | None) -> Garment:
    vertices, faces = loaded.joined()
    distance, _ = cKDTree(np.asarray(model.body.v_template)).query(vertices)
    if np.median(distance) > _MAX_MEDIAN_DISTANCE:
        raise ValueError(
            f"the mesh is not on the mean body: half of its vertices are more than {np.median(distance):.2f} m from it "
            f"(at most {_MAX_MEDIAN_DISTANCE} m); it must stand in metres, y up, +z front, pelvis at the origin"
        )
    config = model.config
    corners = vertices[faces]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    known = _is_known(float(areas.mean()), area) and areas.std() <= areas.mean()
    points, triangles = (vertices, faces) if known else resample(vertices, faces, area)
    graph = build_graph(
        points,
        triangles,
        model.body,
        num_levels=config.num_levels,
        pooling=config.pooling,
        bucket=bucket,
        laplacian=config.laplacian,
    )
    smoother = make_smoother(points, triangles, config.smoothing_length, graph.num_nodes)
    own = None
    if not known:
        found = MeshSearch(points, triangles).closest(vertices)
        own = _carried_mesh(vertices, faces, triangles[found.face], found.weights)
    edges, rest = padded_edges(triangles, edge_lengths(points, triangles), len(points), graph.num_nodes)
    return Garment(graph, smoother, own=own, edges=edges, rest=rest)
