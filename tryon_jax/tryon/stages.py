"""Device side, pure: mean drape, smooth drape, fine drape, one on top of the other (section 4 of the paper)."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tryon_jax.checks import check_choice
from tryon_jax.contact.penetration import BodyContact, PenetrationReport, report_penetration
from tryon_jax.graph.build import GarmentGraph
from tryon_jax.graph.smoothing import smooth
from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.nets.unet import apply_unet
from tryon_jax.tryon.garment import Garment
from tryon_jax.tryon.model import Stage, TryOnModel
from tryon_jax.types import EXACT, ArrayLike, pytree


@pytree
class DrapeStages:
    """The intermediate results of `drape`, all padded, metres."""

    mean: Float[Array, "N 3"]
    """M̄, the drape on the mean body."""
    smooth: Float[Array, "*batch N 3"]
    """M_smooth."""
    fine: Float[Array, "*batch N 3"]
    """M_fine, the result."""
    penetration: PenetrationReport | None = None
    """Of M_fine, where it was asked for."""


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


def drape_stages(
    model: TryOnModel,
    garment: Garment,
    betas: Float[ArrayLike, "*batch b"],
    fabric: str = "gray-interlock",
    design: Float[ArrayLike, " P"] | None = None,
    contact: BodyContact | None = None,
) -> DrapeStages:
    """`drape` with its intermediate results; arguments as there.

    With `contact`, made once by `body_contact(model.body)`, the result also says where M_fine is inside the body.
    """
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

    fine = finish(fine_vertices)
    report = None
    if contact is not None:
        rows = fine.reshape(-1, *fine.shape[-2:])
        report = report_penetration(contact, model.body, rows, flat, garment.body_vertices, garment.mask)
        report = jax.tree.map(lambda x: x.reshape(*betas.shape[:-1], *x.shape[1:]), report)
    return DrapeStages(carry(garment, vertices, vertices), finish(smooth_vertices), fine, report)


def mean_drape(model: TryOnModel, garment: Garment, design: Float[ArrayLike, " P"]) -> Float[Array, "N 3"]:
    """M̄ = W · R_mean(p) at the garment's fixed topology, differentiable in the design; padded vertices are zero.

    Raises:
        ValueError: the garment was not made from a design.
    """
    if garment.template_vertices is None or garment.template_weights is None:
        raise ValueError("this garment is a mesh without a design: its mean drape does not depend on one")
    template = apply_mean_drape(model.mean, jnp.asarray(design))
    return jnp.einsum(
        "vk,vkc->vc", jnp.asarray(garment.template_weights), template[garment.template_vertices], precision=EXACT
    )


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
    width = jnp.asarray(stage.net.head.weight).dtype
    # Networks of half precision compute in it (see `precision`); others follow their inputs.
    inputs = features.astype(width) if jnp.finfo(width).bits < 32 else features
    output = apply_unet(stage.net, graph.levels, inputs)
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
    carried = jnp.einsum("mk,...mkc->...mc", jnp.asarray(own.weights), shift, precision=EXACT)
    return carried + jnp.asarray(own.vertices).reshape((1,) * (moved.ndim - 2) + own.vertices.shape)
