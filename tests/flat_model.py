"""A model that needs no training: all networks are zero, so that every drape is the flat panels round the body."""

from dataclasses import replace

import jax
import numpy as np

from tryon_jax.body import load_body
from tryon_jax.garment import build_template, load_design_space, placement
from tryon_jax.nets.config import load_config
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.tryon import ALL_FABRICS, TryOnModel, init_model, model_parameters

FABRICS = ("gray-interlock", "camel-ponte-roma")


def flat_model(**changes: object) -> TryOnModel:
    """The model; `changes` are fields of its configuration."""
    space = load_design_space()
    template = placement(build_template(space, space.mean_design)).astype(np.float32)
    net = UNetConfig(widths=(4, 4), encoder_convs=1)
    config = load_config("small", smooth=net, fine=net, fabrics=FABRICS, **changes)
    body = load_body(config.body)
    learned = jax.jit(lambda: model_parameters(init_model(jax.random.key(0), config, body=body)))()
    model = TryOnModel(**jax.tree.map(lambda leaf: np.zeros_like(leaf), learned), body=body, config=config)
    mean = replace(model.mean, template_center=template, design_scale=np.ones_like(model.mean.design_scale))
    fine = dict(model.fine)
    if config.shared_fabrics:
        shared = fine[ALL_FABRICS]
        fine[ALL_FABRICS] = replace(shared, fabrics=replace(shared.fabrics, scale=np.ones_like(shared.fabrics.scale)))
    return replace(model, mean=mean, fine=fine)
