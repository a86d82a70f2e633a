"""One training step of R_smooth: gradient and Adam over several garments and body shapes, beside its dense products.

python -m benchmarks training
python -m benchmarks training --configs small --garments 4 --samples 4
"""

from dataclasses import dataclass, replace
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
from benchmarks.record import table, write_record
from tryon_jax.nets import load_config
from tryon_jax.tryon import Stage, apply_stage, smooth_features, stack_garments


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
    settings = load_config(name)
    if order is not None:
        settings = replace(settings, smooth=replace(settings.smooth, order=order))
    model, garment = random_model(settings), garment_of_size(load_config(name), vertices)
    stage, optimiser = model.smooth, optax.adam(1e-3)
    batch = jax.tree.map(jnp.asarray, stack_garments([garment] * config.garments))
    rng = np.random.default_rng(0)
    betas = jnp.asarray(rng.normal(size=(config.garments, config.samples, settings.num_betas)), jnp.float32)
    nodes = garment.graph.num_nodes
    targets = jnp.asarray(rng.normal(size=(config.garments, nodes, config.samples, 3)), jnp.float32)

    def loss(stage: Stage) -> jax.Array:
        def one(garment: Any, betas: jax.Array, target: jax.Array) -> jax.Array:
            moved = apply_stage(stage, garment.graph, smooth_features(settings, garment.graph, betas))
            return ((moved - target) ** 2).mean()

        return jax.vmap(one)(batch, betas, targets).mean()

    def step(stage: Stage, state: Any) -> tuple[Stage, Any]:
        updates, state = optimiser.update(jax.grad(loss)(stage), state)
        return optax.apply_updates(stage, updates), state

    state = optimiser.init(stage)
    made, seconds = compiled(step, stage, state)
    calls = {
        "step": lambda: made(stage, state),
        "floor": dense_floor([stage.net], nodes, config.garments * config.samples, gradient=True),
    }
    times = measure_in_turns(calls, config.repeats, config.max_seconds)
    return {
        "config": name,
        "vertices": garment.num_vertices,
        "nodes": nodes,
        "garments": config.garments,
        "shapes of each": config.samples,
        "order": settings.smooth.order,
        "step, ms": 1e3 * times["step"].median,
        "floor, ms": 1e3 * times["floor"].median,
        "step / floor": times["step"].median / times["floor"].median,
        "drapes/s": config.garments * config.samples / times["step"].median,
        "temporary, MB": temporary_megabytes(made),
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
