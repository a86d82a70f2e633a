"""What the benchmarks of networks share: garments of a given size, dense-product floors, times taken in turns."""

import time
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from measuring.timing import Timing
from tryon_jax.body import load_body
from tryon_jax.garment import build_template, load_design_space, placement, remesh
from tryon_jax.nets import TryOnConfig, UNet
from tryon_jax.nets.cheb import ChebConv
from tryon_jax.tryon import Garment, TryOnModel, init_model, prepare_mesh

PAPER_SIZES = (1414, 2500, 3581)
"""Vertices of the paper's smallest, a middle, and its largest garment."""


def compiled(function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """The function compiled for these arguments, and the seconds that took (tracing included)."""
    start = time.perf_counter()
    made = jax.jit(function).lower(*arguments).compile()
    return made, time.perf_counter() - start


def measure_in_turns(
    calls: Mapping[str, Callable[[], Any]], repeats: int = 20, max_seconds: float = 30.0
) -> dict[str, Timing]:
    """Times of several calls, one of each after the other, so that the machine's other work meets all alike."""
    first = {}
    for name, call in calls.items():
        start = time.perf_counter()
        jax.block_until_ready(call())
        first[name] = time.perf_counter() - start
    times: dict[str, list[float]] = {name: [] for name in calls}
    begin = time.perf_counter()
    rounds = 0
    while rounds < repeats and (rounds < 3 or time.perf_counter() - begin < max_seconds):
        for name, call in calls.items():
            start = time.perf_counter()
            jax.block_until_ready(call())
            times[name].append(time.perf_counter() - start)
        rounds += 1
    result = {}
    for name, values in times.items():
        low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
        result[name] = Timing(first[name], float(middle), float(low), float(high), len(values))
    return result


@cache
def random_model(config: TryOnConfig) -> TryOnModel:
    """A model with random weights about the mean design's template as it is placed before draping."""
    space = load_design_space()
    center = placement(build_template(space, space.mean_design)).astype(np.float32)
    return init_model(jax.random.key(0), config, body=load_body(), template_center=center)


@cache
def garment_of_size(config: TryOnConfig, vertices: int) -> Garment:
    """A garment with about this many vertices: a tank for the smallest, else a maxi dress, of finer or coarser mesh."""
    model = random_model(config)
    space = load_design_space()
    design = space.preset("tank" if vertices < 2000 else "maxi-dress")
    area = config.target_area
    for _ in range(3):
        mesh = remesh(space, design, area)
        if abs(mesh.num_vertices / vertices - 1) < 0.01:
            break
        area *= mesh.num_vertices / vertices
    return prepare_mesh(model, mesh, vertices=placement(mesh))


def layer_shapes(net: UNet, nodes: int) -> list[tuple[int, int, int, int]]:
    """(nodes, K, inputs, outputs) of each convolution of a network on a graph of `nodes` nodes."""
    shapes: list[tuple[int, int, int, int]] = []
    for level, convs in enumerate(net.encoder):
        decoder = net.decoder[level] if level < len(net.decoder) else ()
        shapes += [_shape(nodes >> level, conv) for conv in (*convs, *decoder)]
    return [*shapes, _shape(nodes, net.head)]


def _shape(nodes: int, conv: ChebConv) -> tuple[int, int, int, int]:
    order, inputs, outputs = conv.weight.shape
    return nodes, order, inputs, outputs


def dense_floor(
    nets: list[UNet], nodes: int, samples: int, gradient: bool, dtype: Any = jnp.float32
) -> Callable[[], Any]:
    """The matrix products of the networks' convolutions and nothing else, compiled.

    With `gradient` also the two products per convolution that its derivatives need.
    """
    shapes = [shape for net in nets for shape in layer_shapes(net, nodes)]
    pairs = [(jnp.ones((n * samples, k * i), dtype), jnp.ones((k * i, o), dtype)) for n, k, i, o in shapes]

    def forward(pairs: list[tuple[jax.Array, jax.Array]]) -> list[jax.Array]:
        return [x @ w for x, w in pairs]

    def both(pairs: list[tuple[jax.Array, jax.Array]]) -> list[jax.Array]:
        results = []
        for x, w in pairs:
            y = x @ w
            results += [x.T @ y, y @ w.T]
        return results

    made, _ = compiled(both if gradient else forward, pairs)
    return lambda: made(pairs)


def floor_gigaflops(nets: list[UNet], nodes: int, samples: int) -> float:
    """Floating-point operations of one forward pass's matrix products, in 10⁹."""
    return sum(2e-9 * n * samples * k * i * o for net in nets for n, k, i, o in layer_shapes(net, nodes))


def temporary_megabytes(made: Any) -> float:
    """Memory that a compiled function needs besides its arguments and results, in 10⁶ bytes; NaN where unknown."""
    analysis = made.memory_analysis()
    return float("nan") if analysis is None else analysis.temp_size_in_bytes / 1e6
