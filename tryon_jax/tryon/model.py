"""The model: three regressors, the body they are for, and their configuration."""

from collections.abc import Mapping
from dataclasses import field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from tryon_jax.body.embedded import load_body
from tryon_jax.contact.skin_samples import SkinSamples, sample_skin
from tryon_jax.garment import DesignSpace, load_design_space
from tryon_jax.nets.config import SMALL, TryOnConfig
from tryon_jax.nets.fabric_functions import FabricFunctions, apply_fabric_functions
from tryon_jax.nets.kriging import Kriging, empty_kriging
from tryon_jax.nets.mlp import MLP, MeanDrape, init_mean_drape, init_mlp
from tryon_jax.nets.unet import UNet, UNetConfig, init_unet
from tryon_jax.types import ArrayLike, Body, pytree, static

ALL_FABRICS = "all"
"""Name of the R_fine that serves every fabric."""


@pytree
class Stage:
    """One displacement regressor: a graph U-Net, the size of what it predicts, and how the body's shape weights it."""

    net: UNet
    scale: Float[ArrayLike, ""]
    """Displacements are scale · output, metres (the RMS of the training targets)."""
    coefficients: MLP | None = None
    """From betas and their waves to the weights of the K fields that the network predicts; None where the betas are
    node features."""
    fabrics: FabricFunctions | None = None
    """Of an R_fine of all fabrics: what weights its fields beside the coefficients."""
    fabric_values: Float[ArrayLike, " J"] | None = None
    """Their values for the fabric that is draped (see `of_fabric`)."""


@pytree
class StanceNetwork:
    """R_stance: a stage like the R_fine of all fabrics, whose coefficients see the stance too."""

    stage: Stage
    config: TryOnConfig = static(default=SMALL)
    """Its own, see `stance_config`."""


@pytree
class TryOnModel:
    """Everything `drape` needs besides the garment: the regressors, the body and their configuration."""

    mean: MeanDrape
    """R_mean."""
    smooth: Stage
    """R_smooth."""
    fine: dict[str, Stage]
    """R_fine of each fabric, and under the name `ALL_FABRICS` one of all where there is such."""
    body: Body
    kriging: dict[str, Kriging] = field(default_factory=dict)
    """Kriged drapes of designs in each fabric, where R_fine starts from them and not from M_smooth."""
    stance: StanceNetwork | None = None
    """R_stance, where there is one."""
    skin: SkinSamples | None = None
    """Of the body: with it `drape` keeps cloth clear of the skin; None leaves the networks' drapes as they are, and
    where they predict no fields there is none."""
    config: TryOnConfig = static(default=SMALL)


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
    return keep_off_skin(init_networks(key, config, body=body, template_center=template_center, space=space))


def init_networks(
    key: PRNGKeyArray,
    config: TryOnConfig,
    *,
    body: Body | None = None,
    template_center: Float[ArrayLike, "T 3"] | None = None,
    space: DesignSpace | None = None,
) -> TryOnModel:
    """`init_model` without the `skin`, for what needs the networks alone.

    Args:
        key: Random key.
        config: Sizes and conventions.
        body: As in `init_model`.
        template_center: As in `init_model`.
        space: As in `init_model`.
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

    if config.conditioning == "node" and (config.shared_fabrics or config.kriging):
        raise ValueError('an R_fine of all fabrics and kriged drapes need conditioning="fields", not "node"')
    if len(space.names) != config.num_parameters:
        raise ValueError(f"the configuration has {config.num_parameters} parameters, the space {len(space.names)}")

    def stage(stage_key: PRNGKeyArray, net: UNetConfig, features: int, outputs: int) -> Stage:
        net_key, coefficient_key = jax.random.split(stage_key)
        unet = init_unet(net_key, net, features, outputs)
        if config.conditioning == "node":
            return Stage(unet, jnp.asarray(0.01))
        inputs = config.num_betas * (1 + 2 * len(config.beta_periods))
        coefficients = init_mlp(coefficient_key, (inputs, *config.coefficient_widths, config.fields))
        return Stage(unet, jnp.asarray(0.01), coefficients)

    smooth = stage(keys[1], config.smooth, config.smooth_features, config.outputs)
    features, outputs = config.fine_features, config.outputs
    fine = {
        fabric: stage(k, config.kriged_fine if config.kriging else config.fine, features, outputs)
        for fabric, k in zip(config.fabrics, keys[2:], strict=True)
    }
    if config.shared_fabrics:
        shared = stage(jax.random.fold_in(key, 1), config.fine, features, config.shared_outputs)
        fine[ALL_FABRICS] = replace(shared, fabrics=_no_functions(config))
    kriging = {}
    if config.kriging is not None:
        sizes = config.template_vertices, config.num_parameters, config.num_betas
        kriging = {fabric: empty_kriging(config.kriging, *sizes) for fabric in config.fabrics}
    return TryOnModel(mean, smooth, fine, body, kriging, config=config)


def keep_off_skin(model: TryOnModel) -> TryOnModel:
    """The model with the `skin` of its body; one whose networks predict no fields is left as it is."""
    if model.config.conditioning != "fields":
        return model
    return replace(model, skin=sample_skin(model.body, model.config.beta_ranges))


def _no_functions(config: TryOnConfig) -> FabricFunctions:
    """Functions that are one for every fabric, before they are fitted."""
    count = len(config.shared_fabrics)
    weights = jnp.zeros((count + 1, config.fabric_functions)).at[-1].set(1.0)
    numbers = config.fabric_numbers
    return FabricFunctions(jnp.zeros((count, numbers)), jnp.zeros(numbers), jnp.ones(numbers), weights)


def of_fabric(stage: Stage, numbers: Float[ArrayLike, " F"] | None) -> Stage:
    """An R_fine of all fabrics for one of them.

    Args:
        stage: R_fine.
        numbers: Of the fabric, as `fabric_numbers` gives them; None leaves the stage as it is.
    """
    if numbers is None or stage.fabrics is None:
        return stage
    return replace(stage, fabric_values=apply_fabric_functions(stage.fabrics, jnp.asarray(numbers)))


def config_space(config: TryOnConfig) -> DesignSpace:
    """The design space that a configuration names."""
    return load_design_space(config.layout, config.parameters)


def model_parameters(model: TryOnModel) -> dict[str, Any]:
    """The learned part of a model: what `save_model` stores and training updates."""
    return {"mean": model.mean, "smooth": model.smooth, "fine": model.fine, "kriging": model.kriging}


def with_parameters(model: TryOnModel, parameters: Mapping[str, Any]) -> TryOnModel:
    """The model with other learned parameters, as `model_parameters` gives them."""
    return replace(model, **parameters)
