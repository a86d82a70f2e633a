"""One training step of R_smooth: gradient and Adam over several garments and body shapes, beside its dense products.

Once with the whole batch in one pass, and once a body shape at a time as training does on a CPU.

python -m benchmarks training
python -m benchmarks training --configs small --garments 4 --samples 4
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from benchmarks._networks import (
    compiled,
    dense_floor,
    garment_of_size,
    measure_in_turns,
    random_model,
    temporary_megabytes,
)
from benchmarks.record import write_record
from measuring.records import table
from tryon_jax.nets import load_config, paper_form
from tryon_jax.nets.unet import UNet
from tryon_jax.training.batches import StageBatch
from tryon_jax.training.parts import value_and_grad_in_parts
from tryon_jax.training.stage_loss import stage_loss
from tryon_jax.tryon import Stage, stack_garments


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks training`."""

    configs: tuple[str, ...] = ("small", "paper")
    """Sizes of the networks."""
    vertices: tuple[int, ...] = (1414, 3581)
    """Sizes of the garments."""
    garments: int = 4
    """Garments in a batch."""
    samples: int = 4
    """Body shapes of each."""
    orders: tuple[int, ...] = ()
    """Chebyshev orders to try; the configuration's own when not given."""
    repeats: int = 7
    """Timed steps."""
    max_seconds: float = 40.0
    """Longest time for one row."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def row_of(config: Config, name: str, vertices: int, order: int | None) -> dict[str, Any]:
    """One line of the table."""
    settings = paper_form(load_config(name))
    if order is not None:
        settings = replace(settings, smooth=replace(settings.smooth, order=order))
    model, garment = random_model(settings), garment_of_size(settings, vertices)
    optimiser = optax.adam(1e-3)
    rng = np.random.default_rng(0)
    nodes, shape = garment.graph.num_nodes, (config.garments, config.samples)
    batch = StageBatch(
        stack_garments([garment] * config.garments),
        rng.normal(size=(*shape, settings.num_betas)).astype(np.float32),
        np.zeros((*shape, 1, 3), np.float32),
        rng.normal(size=(*shape, nodes, 3)).astype(np.float32),
    )
    batch = jax.tree.map(jnp.asarray, batch)

    def loss(net: UNet, batch: StageBatch) -> jax.Array:
        return stage_loss(settings, "smooth", Stage(net, model.smooth.scale), batch)

    def step(net: UNet, state: Any, batch: StageBatch, shapes: int) -> tuple[UNet, Any]:
        updates, state = optimiser.update(value_and_grad_in_parts(loss, shapes)(net, batch)[1], state)
        return optax.apply_updates(net, updates), state

    net = model.smooth.net
    state = optimiser.init(net)
    whole, seconds = compiled(partial(step, shapes=0), net, state, batch)
    parts, _ = compiled(partial(step, shapes=1), net, state, batch)
    calls = {
        "whole": lambda: whole(net, state, batch),
        "parts": lambda: parts(net, state, batch),
        "floor": dense_floor([net], nodes, config.garments * config.samples, gradient=True),
    }
    times = measure_in_turns(calls, config.repeats, config.max_seconds)
    best = min(times["whole"].median, times["parts"].median)
    return {
        "config": name,
        "vertices": garment.num_vertices,
        "nodes": nodes,
        "garments": config.garments,
        "shapes of each": config.samples,
        "order": settings.smooth.order,
        "whole batch, ms": 1e3 * times["whole"].median,
        "shape by shape, ms": 1e3 * times["parts"].median,
        "floor, ms": 1e3 * times["floor"].median,
        "best / floor": best / times["floor"].median,
        "drapes/s": config.garments * config.samples / best,
        "temporary, MB": temporary_megabytes(whole),
        "shape by shape, MB": temporary_megabytes(parts),
        "compile, s": seconds,
    }


def main(config: Config) -> None:
    """Measure, print the table, and keep it."""
    orders: tuple[int | None, ...] = config.orders or (None,)
    rows = [row_of(config, name, v, order) for name in config.configs for v in config.vertices for order in orders]
    print(table(rows))
    if config.save:
        note = "medians of steps taken in turns with the floor: dense products of forward and both derivatives alone"
        print(f"wrote {write_record('training', config, rows, note=note)}")
