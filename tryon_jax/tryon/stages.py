"""Device side, pure: M_smooth and M_fine of one garment, the same for users and for training (section 4 of the paper).

With `conditioning="fields"` each network runs once for a garment and predicts displacement fields; with "node" it runs
for each body, as in the paper. Kriged drapes may take R_smooth's place, for garments that were cut from a design. All
forms go through the same two functions.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from tryon_jax.graph.build import GarmentGraph
from tryon_jax.graph.smoothing import smooth
from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.fabric_functions import mix_fields
from tryon_jax.nets.fourier import fourier_features
from tryon_jax.nets.kriging import Kriging, ShapeFunctions, apply_shape_functions, kriged_fields
from tryon_jax.nets.mlp import MLP, apply_mlp
from tryon_jax.nets.unet import apply_unet
from tryon_jax.tryon.features import fine_features, smooth_features
from tryon_jax.tryon.garment import Garment
from tryon_jax.tryon.model import Stage
from tryon_jax.types import EXACT


def smooth_stage(
    config: TryOnConfig, stage: Stage | Kriging, garment: Garment, betas: Float[Array, "B b"]
) -> Float[Array, "B N 3"]:
    """M_smooth, metres: the drapes of the smoothed garment on bodies of several shapes (section 4.2).

    Args:
        config: Of the model.
        stage: R_smooth; or kriged drapes, and the result is these less the detail of M̄.
        garment: The garment.
        betas: Shapes of B bodies.
    """
    base, _ = base_and_detail(config, garment)
    if config.conditioning == "fields":
        return base[None] + weighted_sum(smooth_fields(config, stage, garment), coefficients(config, stage, betas))
    assert isinstance(stage, Stage)
    moved = apply_stage(stage, garment.graph, smooth_features(config, garment, betas))
    return base[None] + jnp.moveaxis(moved, 1, 0)


def fine_stage(
    config: TryOnConfig,
    stage: Stage,
    garment: Garment,
    betas: Float[Array, "B b"],
    smooth_vertices: Float[Array, "B N 3"],
) -> Float[Array, "B N 3"]:
    """M_fine, metres: the drapes with their folds, from M_smooth of the same bodies (section 4.3).

    Args:
        config: Of the model.
        stage: R_fine of a fabric.
        garment: The garment.
        betas: Shapes of B bodies.
        smooth_vertices: M_smooth of each, metres.
    """
    _, detail = base_and_detail(config, garment)
    if config.conditioning == "fields":
        moved = weighted_sum(fine_fields(config, stage, garment, detail), coefficients(config, stage, betas))
    else:
        features = fine_features(config, garment, jnp.moveaxis(smooth_vertices, 0, 1), detail, betas)
        moved = jnp.moveaxis(apply_stage(stage, garment.graph, features), 1, 0)
    return smooth_vertices + (fine_base(config, detail)[None] + moved)


def smooth_fields(config: TryOnConfig, stage: Stage | Kriging, garment: Garment) -> Float[Array, "N 3 K"]:
    """The displacement fields that R_smooth or kriging predicts for a garment, metres; zero at padded nodes.

    Args:
        config: Of the model.
        stage: R_smooth, or kriged drapes.
        garment: One garment.

    Raises:
        ValueError: kriged drapes of a mesh without a design are asked for.
    """
    if isinstance(stage, Kriging):
        if garment.design is None or garment.template_vertices is None or garment.template_weights is None:
            raise ValueError("this garment is a mesh without a design: only designs have kriged drapes")
        width = jnp.asarray(garment.graph.vertices).dtype
        design, weights = (jnp.asarray(array, width) for array in (garment.design, garment.template_weights))
        return kriged_fields(stage, design, jnp.asarray(garment.template_vertices), weights)
    return _split_fields(apply_stage(stage, garment.graph, smooth_features(config, garment)))


def fine_fields(
    config: TryOnConfig, stage: Stage, garment: Garment, detail: Float[Array, "N 3"]
) -> Float[Array, "N 3 K"]:
    """The displacement fields that R_fine predicts for a garment with this detail, metres; zero at padded nodes.

    Args:
        config: Of the model.
        stage: R_fine, where it serves every fabric bound to one by `of_fabric`.
        garment: One garment.
        detail: What its mean drape has beyond its smoothed form, metres.

    Raises:
        ValueError: the stage serves every fabric and is bound to none.
    """
    vertices = jnp.asarray(garment.graph.vertices)[:, None, :]
    fields = _split_fields(apply_stage(stage, garment.graph, fine_features(config, garment, vertices, detail)))
    if stage.fabrics is None:
        return fields
    if stage.fabric_values is None:
        raise ValueError("this R_fine serves every fabric: say which one, by `of_fabric`")
    return mix_fields(fields, jnp.asarray(stage.fabric_values), config.field_pairs, config.fields)


def coefficients(config: TryOnConfig, stage: Stage | Kriging, betas: Float[Array, "B b"]) -> Float[Array, "B K"]:
    """Weights of a stage's fields for bodies of shape `betas`; zero in T-pose where the last of them is the stance.

    Args:
        config: Of the model.
        stage: R_smooth, kriged drapes, R_fine or R_stance.
        betas: Standard deviations.

    Raises:
        ValueError: the stage takes the betas at its nodes.
    """
    functions = shape_functions(stage)
    if functions is None:
        raise ValueError('this model has no fields: it was made with conditioning="node"')
    if config.stance and isinstance(functions, MLP):
        return stance_coefficients(config, functions, betas)
    return field_coefficients(functions, betas, config.beta_scale, config.beta_periods)


def shape_functions(stage: Stage | Kriging) -> MLP | ShapeFunctions | None:
    """What weights the fields of a stage; None where the betas are node features."""
    return stage.shapes if isinstance(stage, Kriging) else stage.coefficients


def stance_coefficients(config: TryOnConfig, mlp: MLP, codes: Float[Array, "B b"]) -> Float[Array, "B K"]:
    """Weights of R_stance's fields: exactly zero in T-pose.

    Args:
        config: Of R_stance.
        mlp: Its perceptron.
        codes: Betas and stance, from `stance.stance_code`.
    """
    here, in_t_pose = (
        field_coefficients(mlp, c, config.beta_scale, config.beta_periods) for c in (codes, codes.at[:, -1].set(0.0))
    )
    return here - in_t_pose


def field_coefficients(
    functions: MLP | ShapeFunctions, betas: Float[Array, "B b"], beta_scale: float, periods: tuple[float, ...]
) -> Float[Array, "B K"]:
    """Coefficients of fields from betas: a perceptron of the scaled betas and their waves, or a kernel's functions.

    Args:
        functions: Of a network's fields, or of kriged ones.
        betas: Standard deviations.
        beta_scale: Standard deviations that the perceptron sees as one.
        periods: Of the waves, standard deviations.
    """
    if isinstance(functions, ShapeFunctions):
        return apply_shape_functions(functions, betas)
    inputs = jnp.concatenate([betas / beta_scale, fourier_features(betas, periods)], axis=-1)
    return apply_mlp(functions, inputs)


def weighted_sum(fields: Float[Array, "N 3 K"], weights: Float[Array, "B K"]) -> Float[Array, "B N 3"]:
    """Σ_k weights_k fields_k for each body: one matrix product."""
    return jnp.einsum("nck,bk->bnc", fields, weights, precision=EXACT)


def apply_stage(stage: Stage, graph: GarmentGraph, features: Float[Array, "N B i"]) -> Float[Array, "N B o"]:
    """Outputs of the stage's network in metres; zero at padded nodes.

    Args:
        stage: Network and scale.
        graph: Of the garment.
        features: Of its nodes.
    """
    width = jnp.asarray(stage.net.head.weight).dtype
    # Networks of half precision compute in it (see `precision`); others follow their inputs.
    inputs = features.astype(width) if jnp.finfo(width).bits < 32 else features
    output = apply_unet(stage.net, graph.levels, inputs)
    return jnp.asarray(graph.mask)[:, None, None] * stage.scale * output


def base_and_detail(config: TryOnConfig, garment: Garment) -> tuple[Float[Array, "N 3"], Float[Array, "N 3"]]:
    """What R_smooth's displacement is added to, and M̄ − smooth(M̄), metres.

    The base is M̄ itself for the reference "paper" and smooth(M̄) for "smoothed".
    """
    vertices = jnp.asarray(garment.graph.vertices)
    smoothed = smooth(garment.smoother, vertices)
    return (smoothed if config.reference == "smoothed" else vertices), vertices - smoothed


def fine_base(config: TryOnConfig, detail: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    """What is added to M_smooth before R_fine's displacement, metres: M̄'s detail for the reference "smoothed"."""
    return detail if config.reference == "smoothed" else jnp.zeros_like(detail)


def _split_fields(outputs: Float[Array, "N 1 o"]) -> Float[Array, "N 3 K"]:
    return outputs.reshape(outputs.shape[0], 3, -1)
