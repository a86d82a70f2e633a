"""Networks on garment graphs: Chebyshev convolution, graph U-Net, the mean-drape regressor and parameter stores."""

from tryon_jax.nets.cheb import ChebConv, cheb_conv, init_cheb_conv
from tryon_jax.nets.config import PAPER, SMALL, TryOnConfig, load_config, paper_form
from tryon_jax.nets.mlp import MLP, MeanDrape, apply_mean_drape, apply_mlp, init_mean_drape, init_mlp
from tryon_jax.nets.unet import UNet, UNetConfig, apply_unet, count_parameters, init_unet

__all__ = [
    "MLP",
    "PAPER",
    "SMALL",
    "ChebConv",
    "MeanDrape",
    "TryOnConfig",
    "UNet",
    "UNetConfig",
    "apply_mean_drape",
    "apply_mlp",
    "apply_unet",
    "cheb_conv",
    "count_parameters",
    "init_cheb_conv",
    "init_mean_drape",
    "init_mlp",
    "init_unet",
    "load_config",
    "paper_form",
]
