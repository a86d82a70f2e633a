"""One process of a data-parallel training of a tiny R_smooth; a program, run by test_parallel.py.

python parallel_worker.py '{"folder": ..., "devices": 2}'
python parallel_worker.py '{"folder": ..., "coordinator": "localhost:1234", "processes": 2, "process": 0}'
"""

import json
import os
import signal
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from tryon_jax.body import load_body
from tryon_jax.garment import load_design_space, placement, remesh
from tryon_jax.nets.config import load_config
from tryon_jax.nets.unet import UNet, UNetConfig
from tryon_jax.training.batches import StageBatch
from tryon_jax.training.loop import LoopOptions, train_loop
from tryon_jax.training.parallel import DataParallel, SingleDevice, joined_processes, visible_devices
from tryon_jax.training.stage_loss import stage_loss
from tryon_jax.tryon import Stage, init_model, prepare_mesh, stack_garments

GARMENTS, SHAPES = 2, 4
EVALUATE_EVERY = 4


def main(task: dict) -> None:
    """Train, alone or with others."""
    if "coordinator" not in task:
        train(task)
        return
    with joined_processes(task["coordinator"], task["processes"], task["process"]):
        train(task)


def train(task: dict) -> None:
    """Train and print the curve and a sum over the weights as one line of JSON."""
    net = UNetConfig(widths=(6,), encoder_convs=1)
    config = load_config("small-node", smooth=net, fine=net, num_levels=1)
    model = init_model(jax.random.key(0), config, body=load_body())
    space = load_design_space()
    garments = []
    # Two garments of one bucket and unequal size: a mean over devices must not weigh them by chance.
    for design in ("tank", "tshirt"):
        mesh = remesh(space, space.preset(design), 2.5e-3)
        garments.append(prepare_mesh(model, mesh, vertices=placement(mesh), bucket=512))
    stacked = stack_garments(garments)
    mask = np.asarray(stacked.graph.mask)[:, None, :, None]
    truth = np.asarray(stacked.graph.vertices)[:, None]

    def draw(rng: np.random.Generator) -> StageBatch:
        betas = rng.normal(size=(GARMENTS, SHAPES, config.num_betas)).astype(np.float32)
        stretch = 1 + 0.05 * betas[:, :, None, :1] + 0.01 * rng.normal(size=(GARMENTS, SHAPES, 512, 3))
        targets = np.where(mask, truth * stretch, 0.0).astype(np.float32)
        if "die_at" in task and task["process"] == 1 and draw.count == task["die_at"]:
            os.kill(os.getpid(), signal.SIGKILL)
        draw.count += 1
        return StageBatch(stacked, betas, np.zeros_like(targets), targets)

    draw.count = 0
    held = draw(np.random.default_rng(99))
    draw.count = 0
    scale = jnp.asarray(0.02)

    def loss(net: UNet, batch: StageBatch) -> jax.Array:
        return stage_loss(config, "smooth", Stage(net, scale), batch)

    measure = jax.jit(loss)
    options = LoopOptions(steps=task.get("steps", 12), learning_rate=5e-3, warmup=2, evaluate_every=EVALUATE_EVERY)
    counts = task.get("devices", [None])
    results = []
    for count in counts:
        if count is None:
            devices = visible_devices()
        else:
            devices = SingleDevice() if count == 1 else DataParallel(jax.devices()[:count])
        folder = Path(task["folder"]) / ("run" if count is None else f"run{count}")
        result = train_loop(
            model.smooth.net, loss, draw, lambda net: float(measure(net, held)), folder, options, {}, devices=devices
        )
        weights = float(sum(np.abs(np.asarray(leaf)).sum(dtype=np.float64) for leaf in jax.tree.leaves(result.params)))
        curve = [{key: row[key] for key in ("step", "loss", "validation")} for row in result.curve]
        results.append({"devices": len(jax.devices()) if count is None else count, "curve": curve, "weights": weights})
    print(json.dumps(results))


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
