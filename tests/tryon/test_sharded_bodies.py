"""Bodies spread over devices along an explicit mesh axis, JAX's default kind of axis."""

import os
import subprocess
import sys

import pytest

_SCRIPT = """
import jax, numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from dataclasses import replace
import tryon_jax as tj
from tests.flat_model import FABRICS
from tryon_jax.nets.config import load_config
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.tryon import init_model

mesh = jax.make_mesh((2,), ("bodies",), axis_types=(AxisType.Explicit,))
net = UNetConfig(widths=(4, 6), encoder_convs=2)
template = tj.load_pretrained().mean
for form in ("small", "small-node"):
    config = load_config(form, smooth=net, fine=net, fabrics=FABRICS)
    model = replace(init_model(jax.random.key(0), config), mean=template)
    garment = tj.prepare(model, "tshirt", target_area=1.5e-3)
    betas = np.random.default_rng(0).uniform(-2, 2, (8, 2)).astype(np.float32)
    spread = jax.device_put(betas, NamedSharding(mesh, PartitionSpec("bodies")))
    drapes = tj.drape(model, garment, spread)
    assert drapes.sharding.spec[0] == "bodies", (form, drapes.sharding)
    assert len(drapes.addressable_shards) == 2, form
    np.testing.assert_allclose(drapes, tj.drape(model, garment, betas), atol=1e-6, err_msg=form)
"""


@pytest.mark.slow
def test_bodies_on_two_devices() -> None:
    environment = os.environ | {
        # The networks are small: optimising their programs would take longer than running them.
        "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
        "JAX_PLATFORMS": "cpu",
        "XLA_FLAGS": "--xla_force_host_platform_device_count=2",
        "PYTHONPATH": os.pathsep.join([os.getcwd(), *filter(None, sys.path)]),
    }
    command = [sys.executable, "-c", _SCRIPT]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
