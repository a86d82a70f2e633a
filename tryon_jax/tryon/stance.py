"""R_stance, device side and pure: what lowered arms change in a drape.

Like R_fine it sees the garment once and predicts displacement fields. Their weights depend on the body's shape, the
stance and the fabric, and vanish in T-pose. The change is added to a drape in T-pose, which is then skinned; so it goes
with any drape, learned or simulated. Beyond the paper, whose bodies all stand in T-pose.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from tryon_jax.body.pose import skinning_motion
from tryon_jax.body.stance import LOWEST, arms_turns
from tryon_jax.checks import check_choice
from tryon_jax.nets.config import SMALL, STANCE_EXTENT, TryOnConfig
from tryon_jax.nets.mlp import MLP
from tryon_jax.tryon.carrying import carry_values
from tryon_jax.tryon.garment import Garment
from tryon_jax.tryon.mean_drape import with_design
from tryon_jax.tryon.model import ALL_FABRICS, Stage, StanceNetwork, TryOnModel, init_networks, of_fabric
from tryon_jax.tryon.stages import base_and_detail, fine_fields, stance_coefficients, weighted_sum
from tryon_jax.types import EXACT, ArrayLike, Body, pytree, static


@pytree
class StanceFields:
    """What lowered arms change in the drape of one garment in one fabric: `stand` adds it and skins."""

    fields: Float[ArrayLike, "*batch M 3 K"]
    """Metres, in T-pose."""
    coefficients: MLP
    """From betas and stance to the K weights."""
    config: TryOnConfig = static(default=SMALL)
    """Of R_stance."""


def init_stance(key: PRNGKeyArray, config: TryOnConfig, body: Body) -> StanceNetwork:
    """R_stance with random weights.

    Args:
        key: Random key.
        config: From `stance_config`.
        body: The body that it is for.
    """
    return StanceNetwork(init_networks(key, config, body=body).fine[ALL_FABRICS], config)


def stance_fields(
    model: TryOnModel,
    garment: Garment,
    fabric: str | Float[ArrayLike, " F"] | None = None,
    design: Float[ArrayLike, " P"] | None = None,
) -> StanceFields:
    """R_stance's part, once for a garment and a fabric. Pure: jit (`static_argnames="fabric"` for a name), grad.

    Args:
        model: With R_stance, as `load_pretrained` gives it.
        garment: From `prepare`.
        fabric: One that R_stance was trained on by name, by default the model's first; or the numbers of any fabric, as
            `fabric_numbers` gives them.
        design: Design parameters in place of the garment's, metres.

    Raises:
        ValueError: A model without R_stance, or an unknown fabric.
    """
    if model.stance is None:
        raise ValueError("this model has no R_stance: its arms are lowered by simulation")
    fabric = model.config.known_fabrics[0] if fabric is None else fabric
    config, stage = model.stance.config, _for_fabric(model.stance, fabric)
    garment = with_design(model, garment, design)
    _, detail = base_and_detail(config, garment)
    fields = carry_values(garment, fine_fields(config, stage, garment, detail))
    assert stage.coefficients is not None
    return StanceFields(fields, stage.coefficients, config)


def stand(
    fields: StanceFields,
    body: Body,
    betas: Float[ArrayLike, "*batch b"],
    degrees: Float[ArrayLike, "*#batch"],
    vertices: Float[ArrayLike, "*batch M 3"],
    skinning: Float[ArrayLike, "M J"],
) -> Float[Array, "*batch M 3"]:
    """Drapes in T-pose on bodies that lower their arms, metres. Pure: jit, vmap, grad, `degrees` included.

    Args:
        fields: From `stance_fields`.
        body: The body.
        betas: Shapes of one body or of many; the fields see the first of them.
        degrees: Of the arms below the horizontal, 0 to `body.stance.LOWEST`; values beyond are not checked.
        vertices: The drapes in T-pose, metres.
        skinning: Skinning weights of their vertices, as `graph.skinning.garment_skinning` gives them; for padded
            vertices anything.
    """
    betas, vertices = jnp.asarray(betas), jnp.asarray(vertices)
    batch = betas.shape[:-1]
    shapes = betas.reshape(-1, betas.shape[-1])
    angles = jnp.broadcast_to(jnp.asarray(degrees, betas.dtype), batch).reshape(-1)
    codes = stance_code(shapes[:, : fields.config.num_betas - 1], angles)
    weights = stance_coefficients(fields.config, fields.coefficients, codes)
    change = weighted_sum(jnp.asarray(fields.fields), weights)
    changed = vertices.reshape(-1, *vertices.shape[-2:]) + change
    turns = jnp.asarray(arms_turns(body), changed.dtype)

    def skinned(shape: Float[Array, " b"], angle: Float[Array, ""], points: Float[Array, "M 3"]) -> Float[Array, "M 3"]:
        linear, shift = skinning_motion(body, shape, jnp.deg2rad(angle) * turns, skinning)
        return jnp.einsum("nab,nb->na", linear, points, precision=EXACT) + shift

    return jax.vmap(skinned)(shapes, angles, changed).reshape(*batch, *changed.shape[1:])


def stance_code(betas: Float[Array, "B b"], degrees: Float[Array, " B"]) -> Float[Array, "B b+1"]:
    """What R_stance's coefficients see: betas and, scaled to be of their size, the stance.

    Args:
        betas: Shapes that the networks see.
        degrees: Of the arms below the horizontal.
    """
    return jnp.concatenate([betas, STANCE_EXTENT / LOWEST * degrees[:, None]], axis=1)


def _for_fabric(network: StanceNetwork, fabric: str | Float[ArrayLike, " F"]) -> Stage:
    stage, config = network.stage, network.config
    assert stage.fabrics is not None
    if not isinstance(fabric, str):
        return of_fabric(stage, fabric)
    name = check_choice("fabric", fabric, config.shared_fabrics)
    return of_fabric(stage, jnp.asarray(stage.fabrics.known)[config.shared_fabrics.index(name)])
