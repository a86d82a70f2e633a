"""The method put together: `prepare` a garment on the host, `drape` it on the device (section 4 of the paper)."""

import dataclasses
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray
from scipy.spatial import cKDTree

from tryon_jax.body.embedded import load_body
from tryon_jax.checks import check_choice, check_finite
from tryon_jax.garment import Design, DesignSpace, GarmentMesh, load_design_space, remesh
from tryon_jax.graph.buckets import bucket_size
from tryon_jax.graph.build import GarmentGraph, build_graph, pad_rows
from tryon_jax.graph.pooling import closest_on_triangles
from tryon_jax.graph.resample import resample
from tryon_jax.graph.smoothing import HeatSmoother, make_smoother, smooth
from tryon_jax.mesh.repair import LoadedGarment, load_garment, repair_mesh
from tryon_jax.nets import store
from tryon_jax.nets.config import SMALL, TryOnConfig
from tryon_jax.nets.mlp import MeanDrape, apply_mean_drape, init_mean_drape
from tryon_jax.nets.unet import UNet, UNetConfig, apply_unet, init_unet
from tryon_jax.types import ArrayLike, Body, pytree, static

# A user's mesh is taken as it is when its mean triangle area is within this factor of what the networks know.
_DENSITY_RANGE = 1.6
# Half of the vertices of the widest simulated dress are within 0.03 m of the closest body vertex.
_MAX_MEDIAN_DISTANCE = 0.12


@pytree
class Stage:
    """One displacement regressor: a graph U-Net and the size of what it predicts."""

    net: UNet
    scale: Float[ArrayLike, ""]
    """Displacements are scale · output, metres (the RMS of the training targets)."""


@pytree
class TryOnModel:
    """Everything `drape` needs besides the garment: the three regressors, the body and their configuration."""

    mean: MeanDrape
    """R_mean."""
    smooth: Stage
    """R_smooth."""
    fine: dict[str, Stage]
    """R_fine of each fabric."""
    body: Body
    config: TryOnConfig = static(default=SMALL)


@pytree
class OwnMesh:
    """A user's mesh, carried by the evenly spaced mesh that the networks see; padded like everything else."""

    vertices: Float[ArrayLike, "*batch M 3"]
    """On the mean body, metres."""
    faces: Int[ArrayLike, "*batch G 3"]
    """Triangles, padded with (0, 0, 0)."""
    carriers: Int[ArrayLike, "*batch M 3"]
    """Vertices of the graph between which each vertex lies."""
    weights: Float[ArrayLike, "*batch M 3"]
    """Their barycentric weights."""
    num_vertices: Int[ArrayLike, "*batch"]


@pytree
class Garment:
    """A garment ready to drape, made by `prepare`; arrays are padded to the graph's size bucket.

    Stack garments of one bucket with `stack_garments` to map over them.
    """

    graph: GarmentGraph
    smoother: HeatSmoother
    """The smoothing that separates smooth from fine, in the metric of the mean drape."""
    design: Float[ArrayLike, "*batch P"] | None = None
    """Design parameters, metres; None for a mesh of the user's own."""
    template_vertices: Int[ArrayLike, "*batch N 3"] | None = None
    """Template vertices whose weighted mean is each vertex of M̄ (W of section 2); None as `design`."""
    template_weights: Float[ArrayLike, "*batch N 3"] | None = None
    own: OwnMesh | None = None
    """The user's mesh where it is not the graph's: then `drape` returns its vertices, N being their padded number."""

    @property
    def num_vertices(self) -> int:
        """Number of real vertices V; host side, one garment."""
        return int(self.graph.num_vertices if self.own is None else self.own.num_vertices)

    @property
    def faces(self) -> Int[np.ndarray, "F 3"]:
        """Triangles without padding; host side, one garment."""
        faces = np.asarray(self.graph.faces if self.own is None else self.own.faces)
        return faces[faces.any(axis=1)]

    @property
    def mean_vertices(self) -> Float[np.ndarray, "V 3"]:
        """M̄ without padding, metres; host side, one garment."""
        return self.unpad(self.graph.vertices if self.own is None else self.own.vertices)

    def unpad(self, vertices: Float[ArrayLike, "*batch N c"]) -> Float[np.ndarray, "*batch V c"]:
        """What `drape` returned, without the padded vertices; host side, one garment."""
        return np.asarray(vertices)[..., : self.num_vertices, :]

    def with_vertices(self, vertices: Float[Array, "N 3"]) -> "Garment":
        """The same garment with another M̄ (padded), for derivatives with respect to its vertices."""
        return dataclasses.replace(self, graph=dataclasses.replace(self.graph, vertices=vertices))


@pytree
class DrapeStages:
    """The intermediate results of `drape`, all padded, metres."""

    mean: Float[Array, "N 3"]
    """M̄, the drape on the mean body."""
    smooth: Float[Array, "*batch N 3"]
    """M_smooth."""
    fine: Float[Array, "*batch N 3"]
    """M_fine, the result."""


def init_model(
    key: PRNGKeyArray,
    config: TryOnConfig = SMALL,
    *,
    body: Body | None = None,
    template_center: Float[ArrayLike, "T 3"] | None = None,
    space: DesignSpace | None = None,
) -> TryOnModel:
    """A model with random weights.

    Args:
        key: Random key; the same key gives the same model.
        config: Sizes and conventions.
        body: The body it is for; by default the embedded one that `config.body` names.
        template_center: Mean of the template's training drapes, about which R_mean predicts; zeros when None.
        space: Design space; by default the one that the configuration names.
    """
    space = space or config_space(config)
    body = body or load_body(config.body)
    keys = jax.random.split(key, 2 + len(config.fabrics))
    center = np.zeros((config.template_vertices, 3), np.float32) if template_center is None else template_center
    mean = init_mean_drape(
        keys[0],
        np.asarray(space.mean, np.float32),
        np.asarray(0.5 * (space.maximum - space.minimum), np.float32),
        center,
        hidden=config.mean_hidden,
    )

    def stage(stage_key: PRNGKeyArray, net: UNetConfig, features: int) -> Stage:
        return Stage(init_unet(stage_key, net, features), jnp.asarray(0.01))

    fine = {
        fabric: stage(k, config.fine, config.fine_features) for fabric, k in zip(config.fabrics, keys[2:], strict=True)
    }
    return TryOnModel(mean, stage(keys[1], config.smooth, config.smooth_features), fine, body, config)


def config_space(config: TryOnConfig) -> DesignSpace:
    """The design space that a configuration names."""
    return load_design_space(config.layout, config.parameters)


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
        target_area: Mean area of the triangles, square metres; by default what the networks were trained on.
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
    return prepare_mesh(model, remesh(space, _as_design(space, design), area, seed=seed), bucket=bucket)


def _load_own(mesh: str | Path | LoadedGarment | tuple[np.ndarray, np.ndarray]) -> LoadedGarment:
    if isinstance(mesh, LoadedGarment):
        return mesh
    if isinstance(mesh, tuple):
        return repair_mesh(np.asarray(mesh[0], float), np.asarray(mesh[1]))
    return load_garment(mesh)


def _prepare_own(model: TryOnModel, loaded: LoadedGarment, area: float, bucket: int | None) -> Garment:
    starts = np.cumsum([0] + [len(piece.vertices) for piece in loaded.pieces])
    vertices = np.concatenate([piece.vertices for piece in loaded.pieces])
    faces = np.concatenate([piece.faces + start for piece, start in zip(loaded.pieces, starts, strict=False)])
    distance, _ = cKDTree(np.asarray(model.body.v_template)).query(vertices)
    if np.median(distance) > _MAX_MEDIAN_DISTANCE:
        raise ValueError(
            f"the mesh is not on the mean body: half of its vertices are more than {np.median(distance):.2f} m from it "
            f"(at most {_MAX_MEDIAN_DISTANCE} m); it must stand in metres, y up, +z front, pelvis at the origin"
        )
    config = model.config
    corners = vertices[faces]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    known = area / _DENSITY_RANGE <= areas.mean() <= area * _DENSITY_RANGE and areas.std() <= areas.mean()
    points, triangles = (vertices, faces) if known else resample(vertices, faces, area)
    graph = build_graph(
        points, triangles, model.body, num_levels=config.num_levels, pooling=config.pooling, bucket=bucket
    )
    smoother = make_smoother(points, triangles, config.smoothing_length, graph.num_nodes)
    if known:
        return Garment(graph, smoother)
    face, weights = closest_on_triangles(vertices, points, triangles)
    size = bucket_size(len(vertices))
    own = OwnMesh(
        vertices=pad_rows(vertices, size, np.float32),
        faces=pad_rows(faces, max(2 * size, len(faces)), np.int32),
        carriers=pad_rows(triangles[face], size, np.int32),
        weights=pad_rows(weights, size, np.float32),
        num_vertices=np.asarray(len(vertices), np.int32),
    )
    return Garment(graph, smoother, own=own)


def _as_design(space: DesignSpace, design: Any) -> Design:
    if design is None:
        return space.mean_design
    if isinstance(design, Design):
        return space.design(design.label, **design.as_dict())
    if isinstance(design, str):
        return space.preset(design)
    if isinstance(design, Mapping):
        return space.design(**design)
    return space.from_values(design)


def prepare_mesh(
    model: TryOnModel,
    mesh: GarmentMesh,
    *,
    vertices: Float[np.ndarray, "V 3"] | None = None,
    bucket: int | None = None,
) -> Garment:
    """As `prepare`, for a garment mesh of φ that exists already (as in training sets).

    Args:
        model: The model that will drape it.
        mesh: Topology and its tie to the template.
        vertices: M̄ in metres; by default W · R_mean(p).
        bucket: Number of nodes to pad to.
    """
    design = np.asarray(mesh.design.values, np.float32)
    if vertices is None:
        template = np.asarray(apply_mean_drape(model.mean, jnp.asarray(design)))
        vertices = np.einsum("vk,vkc->vc", mesh.template_weights, template[mesh.template_vertices])
    points = check_finite("garment vertices", np.asarray(vertices))
    config = model.config
    graph = build_graph(
        points, mesh.faces, model.body, num_levels=config.num_levels, pooling=config.pooling, bucket=bucket
    )
    size = graph.num_nodes
    template_vertices = np.zeros((size, 3), np.int32)
    template_weights = np.zeros((size, 3), np.float32)
    template_vertices[: len(points)] = mesh.template_vertices
    template_weights[: len(points)] = mesh.template_weights
    return Garment(
        graph,
        make_smoother(points, mesh.faces, config.smoothing_length, size),
        design,
        template_vertices,
        template_weights,
    )


def stack_garments(garments: Sequence[Garment]) -> Garment:
    """Garments of one bucket with a leading axis, for `jax.vmap` over garments.

    Raises:
        ValueError: the garments are padded to different sizes.
    """
    sizes = sorted({g.graph.num_nodes for g in garments})
    if len(sizes) != 1 or len({jax.tree.structure(g) for g in garments}) != 1:
        raise ValueError(f"garments of different buckets cannot be stacked: {sizes}; prepare them with one `bucket`")
    return jax.tree.map(lambda *arrays: np.stack([np.asarray(a) for a in arrays]), *garments)


def mean_drape(model: TryOnModel, garment: Garment, design: Float[ArrayLike, " P"]) -> Float[Array, "N 3"]:
    """M̄ = W · R_mean(p) at the garment's fixed topology, differentiable in the design; padded vertices are zero.

    Raises:
        ValueError: the garment was not made from a design.
    """
    if garment.template_vertices is None or garment.template_weights is None:
        raise ValueError("this garment is a mesh without a design: its mean drape does not depend on one")
    template = apply_mean_drape(model.mean, jnp.asarray(design))
    return jnp.einsum("vk,vkc->vc", jnp.asarray(garment.template_weights), template[garment.template_vertices])


def smooth_features(config: TryOnConfig, graph: GarmentGraph, betas: Float[Array, "B b"]) -> Float[Array, "N B i"]:
    """Node features of R_smooth, {v, w, β}, scaled, for B body shapes."""
    shape = (graph.num_nodes, betas.shape[0])
    fixed = jnp.concatenate(
        [
            jnp.asarray(graph.vertices) / config.position_scale,
            jnp.asarray(graph.skinning_weights, jnp.asarray(graph.vertices).dtype) / config.weight_scale,
        ],
        axis=-1,
    )
    return jnp.concatenate(
        [
            jnp.broadcast_to(fixed[:, None, :], (*shape, fixed.shape[-1])),
            jnp.broadcast_to(betas[None] / config.beta_scale, (*shape, betas.shape[-1])),
        ],
        axis=-1,
    )


def fine_features(
    config: TryOnConfig,
    graph: GarmentGraph,
    smooth_vertices: Float[Array, "N B 3"],
    detail: Float[Array, "N 3"],
    betas: Float[Array, "B b"],
) -> Float[Array, "N B i"]:
    """Node features of R_fine: positions of M_smooth, skinning weights and, where configured, betas and M̄'s detail."""
    shape = smooth_vertices.shape[:2]
    parts = [
        smooth_vertices / config.position_scale,
        jnp.asarray(graph.skinning_weights, smooth_vertices.dtype)[:, None, :] / config.weight_scale,
    ]
    if config.fine_betas:
        parts.append(betas[None] / config.beta_scale)
    if config.fine_detail:
        parts.append(detail[:, None, :] / config.detail_scale)
    return jnp.concatenate([jnp.broadcast_to(p, (*shape, p.shape[-1])) for p in parts], axis=-1)


def apply_stage(stage: Stage, graph: GarmentGraph, features: Float[Array, "N B i"]) -> Float[Array, "N B 3"]:
    """Displacements in metres; zero at padded nodes."""
    output = apply_unet(stage.net, graph.levels, features)
    return jnp.asarray(graph.mask)[:, None, None] * stage.scale * output


def base_and_detail(
    config: TryOnConfig, garment: Garment, vertices: Float[Array, "N 3"]
) -> tuple[Float[Array, "N 3"], Float[Array, "N 3"]]:
    """What R_smooth's displacement is added to, and M̄ − smooth(M̄).

    The base is M̄ itself for the reference "paper" and smooth(M̄) for "smoothed".
    """
    smoothed = smooth(garment.smoother, vertices)
    return (smoothed if config.reference == "smoothed" else vertices), vertices - smoothed


def carry(garment: Garment, moved: Float[Array, "*batch N 3"], mean: Float[Array, "N 3"]) -> Float[Array, "*batch M 3"]:
    """Vertices of the user's own mesh when the graph's have moved from `mean`; of the graph where there is no other."""
    own = garment.own
    if own is None:
        return moved
    shift = (moved - mean.reshape((1,) * (moved.ndim - 2) + mean.shape))[..., jnp.asarray(own.carriers), :]
    carried = jnp.einsum("mk,...mkc->...mc", jnp.asarray(own.weights), shift)
    return carried + jnp.asarray(own.vertices).reshape((1,) * (moved.ndim - 2) + own.vertices.shape)


def drape_stages(
    model: TryOnModel,
    garment: Garment,
    betas: Float[ArrayLike, "*batch b"],
    fabric: str = "gray-interlock",
    design: Float[ArrayLike, " P"] | None = None,
) -> DrapeStages:
    """`drape` with its intermediate results; arguments as there."""
    config = model.config
    check_choice("fabric", fabric, model.fine)
    betas = jnp.asarray(betas)
    if betas.shape[-1:] != (config.num_betas,):
        raise ValueError(f"betas must be {config.num_betas} numbers for this model, got shape {betas.shape}")
    graph = garment.graph
    if design is not None:
        graph = dataclasses.replace(graph, vertices=mean_drape(model, garment, design))
    vertices = jnp.asarray(graph.vertices)
    flat = betas.reshape(-1, config.num_betas).astype(vertices.dtype)
    base, detail = base_and_detail(config, garment, vertices)
    smooth_vertices = base[:, None, :] + apply_stage(model.smooth, graph, smooth_features(config, graph, flat))
    offset = apply_stage(model.fine[fabric], graph, fine_features(config, graph, smooth_vertices, detail, flat))
    fine_vertices = smooth_vertices + offset
    if config.reference == "smoothed":
        fine_vertices = fine_vertices + detail[:, None, :]

    def finish(x: Float[Array, "N B 3"]) -> Float[Array, "*batch M 3"]:
        moved = jnp.moveaxis(x, 0, 1).reshape(*betas.shape[:-1], *vertices.shape)
        return carry(garment, moved, vertices)

    return DrapeStages(carry(garment, vertices, vertices), finish(smooth_vertices), finish(fine_vertices))


def drape(
    model: TryOnModel,
    garment: Garment,
    betas: Float[ArrayLike, "*batch b"],
    fabric: str = "gray-interlock",
    design: Float[ArrayLike, " P"] | None = None,
) -> Float[Array, "*batch N 3"]:
    """Vertices of the garment on the body of shape `betas`, metres, padded: `garment.unpad` drops the padding.

    Pure: jit (`static_argnames="fabric"`), vmap over betas and over stacked garments, grad with respect to betas,
    design, the garment's vertices and every weight. Nothing is compiled anew for another garment of the same bucket.

    Args:
        model: From `load_pretrained`, `load_model` or training.
        garment: From `prepare`.
        betas: Shape coefficients; several body shapes at once are cheaper than one by one.
        fabric: One of `model.config.fabrics`.
        design: Design parameters in metres for M̄ = W · R_mean(p) at the garment's topology; by default M̄ as
            prepared.

    Raises:
        ValueError: for an unknown fabric or another number of betas than the model has (when tracing).
    """
    return drape_stages(model, garment, betas, fabric, design).fine


def model_parameters(model: TryOnModel) -> dict[str, Any]:
    """The learned part of a model: what `save_model` stores and training updates."""
    return {"mean": model.mean, "smooth": model.smooth, "fine": model.fine}


def with_parameters(model: TryOnModel, parameters: Mapping[str, Any]) -> TryOnModel:
    """The model with other learned parameters, as `model_parameters` gives them."""
    return dataclasses.replace(model, **parameters)


def save_model(path: str | Path, model: TryOnModel, training: Mapping[str, Any] | None = None) -> None:
    """Write parameters, configuration, body and pattern fingerprints and a training record to a safetensors file."""
    store.save_store(
        path, model_parameters(model), _record(model.config, model.body) | {"training": dict(training or {})}
    )


def load_model(path: str | Path, body: Body | None = None) -> TryOnModel:
    """Read a model written by `save_model`.

    Args:
        path: A safetensors file.
        body: The body it was made for, where that is not embedded.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no store, damaged, or made for another body, pattern or version; the difference is named.
    """
    record = store.read_record(path)
    config = _config_from_record(record.get("config", {}))
    body = body or load_body(config.body)
    faults = store.compare_records(record, _record(config, body))
    if faults:
        raise ValueError(f"{str(path)!r} was made for something else: " + "; ".join(faults))
    built: list[Any] = []

    def expected() -> dict[str, Array]:
        parameters = model_parameters(init_model(jax.random.key(0), config, body=body))
        named = store.tree_names(parameters)
        built.append((jax.tree.structure(parameters), list(named)))
        return named

    # Shapes only: nothing is initialised.
    arrays = store.load_store(path, jax.eval_shape(expected))
    structure, names = built[0]
    parameters = jax.tree.unflatten(structure, [arrays[name] for name in names])
    return TryOnModel(**parameters, body=body, config=config)


def load_pretrained(name: str = "small") -> TryOnModel:
    """The model that comes with the library: trained weights, body and pattern, nothing to download.

    Raises:
        ValueError: there is no model of that name.
    """
    folder = resources.files("tryon_jax") / "data" / "models"
    names = sorted(entry.name.removesuffix(".safetensors") for entry in folder.iterdir()) if folder.is_dir() else []
    check_choice("pretrained model", name, names)
    with resources.as_file(folder / f"{name}.safetensors") as path:
        return load_model(path)


def _record(config: TryOnConfig, body: Body) -> dict[str, Any]:
    space = config_space(config)
    return {
        "config": store.config_record(config),
        "body": {"name": body.name, "hash": store.hash_body(body)},
        "pattern": {
            "layout": config.layout,
            "parameters": list(space.names),
            "hash": store.hash_arrays(space.minimum, space.mean, space.maximum),
        },
        "units": {"length": "m", "angle": "rad"},
    }


def _config_from_record(record: Mapping[str, Any]) -> TryOnConfig:
    """The configuration of a stored record, lists back to tuples; raises naming unknown or missing fields."""

    def build(cls: type, values: Mapping[str, Any], where: str) -> Any:
        names = [f.name for f in dataclasses.fields(cls)]
        if set(names) != set(values):
            raise ValueError(f"{where} has other fields than this version: {sorted(set(names) ^ set(values))}")
        return cls(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})

    values = dict(record)
    for part in ("smooth", "fine"):
        if not isinstance(values.get(part), Mapping):
            raise ValueError(f"the stored configuration has no field {part!r}")
        values[part] = build(UNetConfig, values[part], f"the stored configuration of {part!r}")
    return build(TryOnConfig, values, "the stored configuration")
