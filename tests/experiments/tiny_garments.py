"""Small stand-ins for trained models and simulated garments, with known answers."""

from dataclasses import replace

import jax
import numpy as np

from tryon_jax import load_pretrained
from tryon_jax.garment import load_manifest, remesh
from tryon_jax.nets.config import load_config
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.tryon import config_space, init_model, prepare_mesh

FABRIC = "gray-interlock"
AREA = 4e-3
"""Mean triangle area of coarse garments: about a hundred vertices."""


def tiny_model():
    """A trained R_mean with small untrained displacement networks."""
    trained = load_pretrained()
    net = UNetConfig(widths=(8, 8), encoder_convs=1)
    config = load_config(
        "small",
        smooth=net,
        fine=net,
        num_levels=2,
        target_area=AREA,
        fabrics=(FABRIC,),
        mean_hidden=trained.config.mean_hidden,
    )
    return replace(init_model(jax.random.key(0), config, body=trained.body), mean=trained.mean)


def stretched(model, name="tshirt-0", betas=None, per_beta=(0.01, 0.005)):
    """A garment that every beta moves along x and y by so many metres, smooth everywhere."""
    manifest = load_manifest()
    label, seed = name.rsplit("-", 1)
    mesh = remesh(config_space(model.config), manifest.design(label), AREA, seed=int(seed))
    garment = prepare_mesh(model, mesh)
    if betas is None:
        radius = np.linspace(0, 1.5, 6)
        angle = np.array([0.3, 2.0, 4.0])
        betas = np.unique(
            np.concatenate([np.outer(radius, [np.cos(a), np.sin(a)]) for a in angle]).round(6), axis=0
        ).astype(np.float32)
    betas = np.asarray(betas, np.float32)
    move = np.zeros((len(betas), 1, 3), np.float32)
    move[:, 0, 0], move[:, 0, 1] = per_beta[0] * betas[:, 0], per_beta[1] * betas[:, 1]
    vertices = np.asarray(garment.graph.vertices)[None] + move
    vertices = vertices * np.asarray(garment.graph.mask)[None, :, None]
    good = np.ones(len(betas), bool)
    test = (np.arange(len(betas)) % 3 == 1) & (betas != 0).any(axis=1)
    return SimulatedGarment(
        name,
        garment,
        betas,
        test,
        {FABRIC: vertices.astype(np.float32)},
        {FABRIC: good},
        vertices.astype(np.float32),
        good,
    )
