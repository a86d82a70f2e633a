"""Device side, pure: the drape of a garment on bodies of any shape, by itself or from fields made once for it."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tryon_jax.checks import check_choice
from tryon_jax.contact.penetration import BodyContact, PenetrationReport, report_penetration
from tryon_jax.nets.kriging import Kriging, ShapeFunctions
from tryon_jax.nets.mlp import MLP
from tryon_jax.tryon.carrying import carry_values, move_with_graph
from tryon_jax.tryon.corrections import Corrections, correct, measure_corrections
from tryon_jax.tryon.garment import Garment
from tryon_jax.tryon.mean_drape import with_design
from tryon_jax.tryon.model import ALL_FABRICS, Stage, TryOnModel, of_fabric
from tryon_jax.tryon.stages import (
    base_and_detail,
    field_coefficients,
    fine_base,
    fine_fields,
    fine_stage,
    shape_functions,
    smooth_fields,
    smooth_stage,
    weighted_sum,
)
from tryon_jax.types import ArrayLike, pytree, static


@pytree
class StageFields:
    """What one stage adds: an offset and a sum of K fields, weighted by the body's shape."""

    offset: Float[ArrayLike, "*batch M 3"]
    """Metres."""
    fields: Float[ArrayLike, "*batch M 3 K"]
    """Metres."""
    coefficients: MLP | ShapeFunctions
    """From betas to the K weights."""


@pytree
class DrapeFields:
    """The drape of one garment in one fabric as a function of the body's shape: `apply_fields` evaluates it.

    It needs neither the networks nor the graph, and a new body costs one matrix product. M is the padded number of
    vertices of the garment's own mesh.
    """

    smooth: StageFields
    """M_smooth, or the kriged drape less the detail of M̄."""
    fine: StageFields
    """What M_fine has beyond it."""
    corrections: Corrections | None = None
    """What keeps M_fine off the skin and its edges short, for a model that has a `skin`."""
    beta_scale: float = static(default=2.0)
    beta_periods: tuple[float, ...] = static(default=())


@pytree
class DrapeStages:
    """The intermediate results of `drape`, all padded, metres."""

    mean: Float[Array, "N 3"]
    """M̄, the drape on the mean body."""
    smooth: Float[Array, "*batch N 3"]
    """M_smooth, or the kriged drape less the detail of M̄."""
    fine: Float[Array, "*batch N 3"]
    """M_fine, the result."""
    penetration: PenetrationReport | None = None
    """Of M_fine, where it was asked for."""


def drape(
    model: TryOnModel,
    garment: Garment,
    betas: Float[ArrayLike, "*batch b"],
    fabric: str | Float[ArrayLike, " F"] | None = None,
    design: Float[ArrayLike, " P"] | None = None,
) -> Float[Array, "*batch N 3"]:
    """Vertices of the garment on the body of shape `betas`, metres, padded: `garment.unpad` drops the padding.

    A model with a `skin`, as all that predict fields have, keeps cloth clear of it and edges short (`corrections`).

    Pure: jit (`static_argnames="fabric"`), vmap over betas and over stacked garments, grad with respect to betas,
    design, the garment's vertices and every weight. Nothing is compiled anew for another garment of the same bucket.
    For many bodies of one garment, `drape_fields` once and then `apply_fields` save the networks' part.

    Args:
        model: From `load_pretrained`, `load_model` or training.
        garment: From `prepare`.
        betas: Shape coefficients; several body shapes at once are cheaper than one by one.
        fabric: One of `model.config.known_fabrics`, by default the first; or the numbers of any fabric, as
            `fabric_numbers` gives them, an array like any other to jit and grad.
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
    fabric: str | Float[ArrayLike, " F"] | None = None,
    design: Float[ArrayLike, " P"] | None = None,
    contact: BodyContact | None = None,
) -> DrapeStages:
    """`drape` with its intermediate results; arguments as there.

    With `contact`, made once by `body_contact(model.body)`, the result also says where M_fine is inside the body.

    Args:
        model: Networks and body.
        garment: From `prepare`.
        betas: Body shapes, standard deviations.
        fabric: As in `drape`.
        design: Design parameters in place of the garment's, metres.
        contact: From `body_contact(model.body)`; with it the result says where M_fine is inside the body.
    """
    garment = with_design(model, garment, design)
    vertices = jnp.asarray(garment.graph.vertices)
    rows, batch = _rows(model.config.num_betas, betas, vertices.dtype)
    if model.config.conditioning == "fields":
        smooth, fine = _evaluate(drape_fields(model, garment, fabric), rows)
    else:
        first, second = stages_of(model, garment, fabric)
        moved = smooth_stage(model.config, first, garment, rows)
        fine = move_with_graph(garment, fine_stage(model.config, second, garment, rows, moved), vertices)
        smooth = move_with_graph(garment, moved, vertices)
    report = None
    if contact is not None:
        report = report_penetration(contact, model.body, fine, rows, garment.body_vertices, garment.mask)
        report = jax.tree.map(lambda x: x.reshape(*batch, *x.shape[1:]), report)
    smooth, fine = (x.reshape(*batch, *x.shape[1:]) for x in (smooth, fine))
    return DrapeStages(move_with_graph(garment, vertices, vertices), smooth, fine, report)


def drape_fields(
    model: TryOnModel,
    garment: Garment,
    fabric: str | Float[ArrayLike, " F"] | None = None,
    design: Float[ArrayLike, " P"] | None = None,
) -> DrapeFields:
    """The networks' part of `drape`, once for a garment and a fabric; arguments as there.

    Args:
        model: Networks and body.
        garment: From `prepare`.
        fabric: As in `drape`.
        design: Design parameters in place of the garment's, metres.

    Raises:
        ValueError: for an unknown fabric, or a model with `conditioning="node"`, which has no fields.
    """
    config, (first, fine) = model.config, stages_of(model, garment, fabric)
    functions = shape_functions(first)
    if functions is None or fine.coefficients is None:
        raise ValueError('this model has no fields: it was made with conditioning="node"; use `drape`')
    garment = with_design(model, garment, design)
    base, detail = base_and_detail(config, garment)
    smooth_part = StageFields(base, smooth_fields(config, first, garment), functions)
    fine_part = StageFields(fine_base(config, detail), fine_fields(config, fine, garment, detail), fine.coefficients)
    fields = DrapeFields(smooth_part, fine_part, None, config.beta_scale, config.beta_periods)
    corrections = None
    if model.skin is not None:
        _, drapes = _evaluate(fields, jnp.asarray(model.skin.polynomials.betas, base.dtype))
        carried = move_with_graph(garment, drapes, jnp.asarray(garment.graph.vertices))
        corrections = measure_corrections(model.skin, garment, drapes, carried)
    smooth_part, fine_part = _carry_fields(garment, smooth_part, fine_part)
    return dataclasses.replace(fields, smooth=smooth_part, fine=fine_part, corrections=corrections)


def apply_fields(fields: DrapeFields, betas: Float[ArrayLike, "*batch b"]) -> Float[Array, "*batch M 3"]:
    """The drape on bodies of shape `betas`, metres, padded; equals `drape` of the garment that the fields are of.

    Args:
        fields: From `drape_fields`.
        betas: Shape coefficients of one body or of many.
    """
    return field_stages(fields, betas)[1]


def field_stages(
    fields: DrapeFields, betas: Float[ArrayLike, "*batch b"]
) -> tuple[Float[Array, "*batch M 3"], Float[Array, "*batch M 3"]]:
    """M_smooth and M_fine of `apply_fields`; arguments as there."""
    rows, batch = _rows(None, betas, jnp.asarray(fields.smooth.fields).dtype)
    smooth, fine = _evaluate(fields, rows)
    return smooth.reshape(*batch, *smooth.shape[1:]), fine.reshape(*batch, *fine.shape[1:])


def stages_of(
    model: TryOnModel, garment: Garment, fabric: str | Float[ArrayLike, " F"] | None
) -> tuple[Stage | Kriging, Stage]:
    """What drapes a garment in a fabric: R_smooth or kriging, and the R_fine that was trained on what this leaves.

    A garment that was cut from a design starts from its kriged drape in the fabrics that have such.

    Args:
        model: Networks.
        garment: The garment.
        fabric: As in `drape`.

    Raises:
        ValueError: the model does not know the fabric, or cannot drape a mesh without a design in it.
    """
    if isinstance(fabric, str | None) and garment.design is not None:
        name = fabric or model.config.known_fabrics[0]
        if name in model.kriging:
            return model.kriging[name], model.fine[name]
    return model.smooth, fine_of(model, fabric)


def fine_of(model: TryOnModel, fabric: str | Float[ArrayLike, " F"] | None) -> Stage:
    """The R_fine that starts from R_smooth, in a fabric.

    Args:
        model: Networks.
        fabric: One of the model's by name, the first when None; or the numbers of any.

    Raises:
        ValueError: the model does not know the fabric, or only as kriged drapes of designs.
    """
    config = model.config
    if not isinstance(fabric, str | None):
        if not config.shared_fabrics:
            known = ", ".join(map(repr, config.fabrics))
            raise ValueError(f"this model has one R_fine for each fabric and takes names, not numbers: {known}")
        return of_fabric(model.fine[ALL_FABRICS], fabric)
    name = check_choice("fabric", fabric or config.known_fabrics[0], config.known_fabrics)
    if name in model.fine and name not in model.kriging:
        return model.fine[name]
    if name not in config.shared_fabrics:
        raise ValueError(f"without an R_fine of all fabrics, this model drapes only designs in {name!r}")
    stage = model.fine[ALL_FABRICS]
    assert stage.fabrics is not None
    return of_fabric(stage, jnp.asarray(stage.fabrics.known)[config.shared_fabrics.index(name)])


def _carry_fields(garment: Garment, smooth: StageFields, fine: StageFields) -> tuple[StageFields, StageFields]:
    """Fields at the vertices of the user's own mesh, where there is one: `move_with_graph` is affine."""
    if garment.own is None:
        return smooth, fine
    mean = jnp.asarray(garment.graph.vertices)
    offset = move_with_graph(garment, jnp.asarray(smooth.offset), mean)
    return (
        StageFields(offset, carry_values(garment, smooth.fields), smooth.coefficients),
        StageFields(carry_values(garment, fine.offset), carry_values(garment, fine.fields), fine.coefficients),
    )


def _evaluate(fields: DrapeFields, betas: Float[Array, "B b"]) -> tuple[Float[Array, "B M 3"], Float[Array, "B M 3"]]:
    """M_smooth and M_fine."""

    def part(stage: StageFields) -> Float[Array, "B M 3"]:
        weights = field_coefficients(stage.coefficients, betas, fields.beta_scale, fields.beta_periods)
        return jnp.asarray(stage.offset)[None] + weighted_sum(jnp.asarray(stage.fields), weights)

    smooth = part(fields.smooth)
    fine = smooth + part(fields.fine)
    return smooth, fine if fields.corrections is None else correct(fields.corrections, fine, betas)


def _rows(
    num_betas: int | None, betas: Float[ArrayLike, "*batch b"], dtype: jnp.dtype
) -> tuple[Float[Array, "B b"], tuple[int, ...]]:
    """Betas as a matrix, and the shape of the batch."""
    array = jnp.asarray(betas)
    if num_betas is not None and array.shape[-1:] != (num_betas,):
        raise ValueError(f"betas must be {num_betas} numbers for this model, got shape {array.shape}")
    return array.reshape(-1, array.shape[-1]).astype(dtype), array.shape[:-1]
