"""Drapes per second: both U-Nets, forward and gradient, beside their dense products alone and PyTorch Geometric.

python -m benchmarks drape
python -m benchmarks drape --configs small --vertices 3581 --batches 1 8
"""

import importlib.util
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from benchmarks._networks import (
    PAPER_SIZES,
    compiled,
    dense_floor,
    floor_gigaflops,
    garment_of_size,
    measure_in_turns,
    random_model,
    temporary_megabytes,
)
from benchmarks.record import write_record
from measuring.records import table
from tryon_jax.nets import load_config, paper_form
from tryon_jax.tryon import Garment, TryOnModel, drape, prepare


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks drape`."""

    configs: tuple[str, ...] = ("small", "paper")
    """Sizes of the networks."""
    vertices: tuple[int, ...] = (*PAPER_SIZES, 14_000, 56_000)
    """Sizes of the garment."""
    batches: tuple[int, ...] = (1, 8, 64)
    """Body shapes in one call."""
    gradient: bool = True
    """Measure the gradient by the weights too."""
    peers: bool = True
    """Measure PyTorch Geometric's ChebConv with the same weights, where it is installed."""
    max_gigabytes: float = 4.0
    """Rows whose activations would need more are left out."""
    repeats: int = 10
    """Timed calls of each kind."""
    max_seconds: float = 30.0
    """Longest time for one row."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def loss(model: TryOnModel, garment: Garment, betas: jax.Array) -> jax.Array:
    """Something to differentiate by every weight."""
    return (drape(model, garment, betas, model.config.fabrics[0]) ** 2).mean()


def weights_gradient(model: TryOnModel, garment: Garment, betas: jax.Array) -> Any:
    """Gradient by the weights of both U-Nets."""
    fabric = model.config.fabrics[0]

    def by_parts(smooth: Any, fine: Any) -> jax.Array:
        changed = replace(model, smooth=smooth, fine={fabric: fine})
        return loss(changed, garment, betas)

    return jax.grad(by_parts, argnums=(0, 1))(model.smooth, model.fine[fabric])


def row_of(config: Config, name: str, vertices: int, batch: int) -> dict[str, Any] | None:
    """One line of the table, or None where it would not fit into memory."""
    settings = paper_form(load_config(name))
    model, garment = random_model(settings), garment_of_size(settings, vertices)
    nodes = garment.graph.num_nodes
    widest = sum(sum(net.widths) for net in (settings.smooth, settings.fine))
    if 4e-9 * nodes * batch * 3 * widest > config.max_gigabytes:
        return None
    garment = jax.tree.map(jnp.asarray, garment)
    betas = jnp.asarray(np.random.default_rng(0).normal(size=(batch, settings.num_betas)), jnp.float32)
    nets = [model.smooth.net, model.fine[settings.fabrics[0]].net]
    forward, seconds = compiled(partial(drape, fabric=settings.fabrics[0]), model, garment, betas)
    calls = {
        "forward": lambda: forward(model, garment, betas),
        "floor": dense_floor(nets, nodes, batch, gradient=False),
    }
    row: dict[str, Any] = {
        "config": name,
        "vertices": garment.num_vertices,
        "nodes": nodes,
        "batch": batch,
        "compile, s": seconds,
        "temporary, MB": temporary_megabytes(forward),
    }
    if config.gradient:
        backward, row["compile gradient, s"] = compiled(weights_gradient, model, garment, betas)
        row["temporary of gradient, MB"] = temporary_megabytes(backward)
        calls["gradient"] = lambda: backward(model, garment, betas)
        calls["gradient floor"] = dense_floor(nets, nodes, batch, gradient=True)
    if config.peers and importlib.util.find_spec("torch_geometric"):
        from benchmarks._pyg import difference, peer

        calls["PyTorch Geometric"] = peer(model, garment, betas)
        row["largest difference, m"] = difference(calls["PyTorch Geometric"], forward(model, garment, betas))
    times = measure_in_turns(calls, config.repeats, config.max_seconds)
    row |= {f"{key}, ms": 1e3 * t.median for key, t in times.items()}
    row["drapes/s"] = batch / times["forward"].median
    row["forward / floor"] = times["forward"].median / times["floor"].median
    if config.gradient:
        row["gradient / floor"] = times["gradient"].median / times["gradient floor"].median
    if "PyTorch Geometric" in times:
        row["times PyTorch Geometric"] = times["PyTorch Geometric"].median / times["forward"].median
    row["floor, GFLOP/s"] = floor_gigaflops(nets, nodes, batch) / times["floor"].median
    return row


def count_compilations(config: Config) -> int:
    """Compilations of a jitted drape when garments of new topologies meet a bucket that it knows."""
    settings = paper_form(load_config(config.configs[0]))
    model, first = random_model(settings), garment_of_size(settings, 1414)
    jitted = jax.jit(drape, static_argnames="fabric")
    betas = jnp.zeros(settings.num_betas)
    jitted(model, first, betas, fabric=settings.fabrics[0])
    before = jitted._cache_size()  # pyright: ignore[reportAttributeAccessIssue]
    for seed in (1, 2):
        other = prepare(model, "tank", seed=seed, bucket=first.graph.num_nodes)
        jitted(model, other, betas, fabric=settings.fabrics[0])
    return jitted._cache_size() - before  # pyright: ignore[reportAttributeAccessIssue]


def main(config: Config) -> None:
    """Measure, print the table, and keep it."""
    rows = []
    cases = [(c, v, b) for c in config.configs for v in config.vertices for b in config.batches]
    for name, vertices, batch in tqdm(cases, leave=False):
        row = row_of(config, name, vertices, batch)
        if row is not None:
            rows.append(row)
            print({k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()}, flush=True)
    left_out = len(cases) - len(rows)
    compilations = count_compilations(config)
    columns = list(dict.fromkeys(key for row in rows for key in row))
    print(table([{c: row.get(c, "") for c in columns} for row in rows]))
    print(f"{compilations} compilations for new topologies in a known bucket; {left_out} rows left out for memory")
    if config.save:
        note = (
            "medians of calls taken in turns; floor: the networks' dense products alone, no sparse operator, no "
            f"activation; {compilations} compilations for new topologies in a known bucket"
        )
        print(f"wrote {write_record('drape', config, rows, note=note)}")
