"""The sparse product and one Chebyshev convolution: ways to execute them, beside SciPy and the dense product alone.

python -m benchmarks layers
python -m benchmarks layers --vertices 3581 --columns 64 512
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from benchmarks._networks import compiled, garment_of_size, measure_in_turns
from benchmarks.record import write_record
from measuring.records import table
from tryon_jax.graph import SparseOperator, apply_operator
from tryon_jax.nets import SMALL, ChebConv, cheb_conv, init_cheb_conv


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks layers`."""

    vertices: tuple[int, ...] = (1414, 3581)
    """Sizes of the garments."""
    columns: tuple[int, ...] = (32, 256, 768)
    """Columns of the sparse product: body shapes times features."""
    samples: int = 8
    """Body shapes of a convolution."""
    features: tuple[int, ...] = (32, 64, 128)
    """Inputs and outputs of a convolution."""
    order: int = 2
    """Chebyshev order K."""
    repeats: int = 20
    """Timed calls of each kind."""
    max_seconds: float = 15.0
    """Longest time for one row."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def gathered(operator: SparseOperator, x: jax.Array) -> jax.Array:
    """All neighbours gathered into one array, then summed."""
    columns, weights = jnp.asarray(operator.rows.columns), jnp.asarray(operator.rows.weights)
    near = x.at[columns].get(mode="promise_in_bounds")
    return _finish(operator, x, jnp.einsum("kn,knc->nc", weights, near))


def scanned(operator: SparseOperator, x: jax.Array) -> jax.Array:
    """`lax.scan` over the neighbour slots."""

    def add(total: jax.Array, slot: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        return total + slot[1][:, None] * x.at[slot[0]].get(mode="promise_in_bounds"), None

    lists = (jnp.asarray(operator.rows.columns), jnp.asarray(operator.rows.weights))
    return _finish(operator, x, jax.lax.scan(add, jnp.zeros_like(x), lists)[0])


def unrolled(operator: SparseOperator, x: jax.Array) -> jax.Array:
    """A plain sum over the neighbour slots, which XLA may fuse with anything."""
    total = jnp.zeros_like(x)
    for column, weight in zip(operator.rows.columns, operator.rows.weights, strict=True):
        total = total + jnp.asarray(weight)[:, None] * x.at[jnp.asarray(column)].get(mode="promise_in_bounds")
    return _finish(operator, x, total)


def _finish(operator: SparseOperator, x: jax.Array, total: jax.Array) -> jax.Array:
    rows = operator.rows
    near = x.at[jnp.asarray(rows.tail_columns)].get(mode="promise_in_bounds")
    tail = jnp.einsum("kn,knc->nc", jnp.asarray(rows.tail_weights), near)
    total = total.at[jnp.asarray(rows.tail_rows)].add(tail, mode="drop")
    return total if operator.diagonal is None else total + jnp.asarray(operator.diagonal)[:, None] * x


PRODUCTS: dict[str, Callable[[Any, jax.Array], jax.Array]] = {
    "library": apply_operator,
    "scan over slots": scanned,
    "gather, then sum": gathered,
    "unrolled sum": unrolled,
}
"""Ways to execute the product; the first is the library's."""


def products(config: Config) -> list[dict[str, Any]]:
    """Forward times of the sparse product alone."""
    rows = []
    for vertices in config.vertices:
        operator = garment_of_size(SMALL, vertices).graph.levels[0].laplacian
        bcoo = operator.to_bcoo()
        # Else each call would carry it to the device.
        operator = jax.device_put(operator)
        index = np.asarray(bcoo.indices)
        csr = sp.coo_array((np.asarray(bcoo.data), (index[:, 0], index[:, 1])), shape=bcoo.shape).tocsr()
        for columns in config.columns:
            x = jnp.asarray(np.random.default_rng(0).normal(size=(operator.shape[1], columns)), jnp.float32)
            on_host = np.asarray(x)
            expected = csr @ on_host
            calls: dict[str, Callable[[], Any]] = {}
            for name, function in PRODUCTS.items():
                made, _ = compiled(function, operator, x)
                np.testing.assert_allclose(made(operator, x), expected, atol=1e-4)
                calls[name] = partial(made, operator, x)
            made, _ = compiled(lambda m, x: m @ x, bcoo, x)
            calls["BCOO"] = partial(made, bcoo, x)
            times = measure_in_turns(calls, config.repeats, config.max_seconds)
            # By itself: a card rests while the host computes, and whoever is called next pays for that.
            on_the_host = {"SciPy CSR, one thread": partial(csr.dot, on_host)}
            times |= measure_in_turns(on_the_host, config.repeats, config.max_seconds)
            row = {"nodes": operator.shape[0], "columns": columns}
            row |= {f"{name}, ms": 1e3 * t.median for name, t in times.items()}
            # The result is written and every neighbour read once: what bandwidth that would be without a cache.
            moved = 4e-9 * columns * (csr.nnz + operator.shape[0])
            rows.append(row | {"library, GB/s": moved / times["library"].median})
    return rows


def convolutions(config: Config) -> list[dict[str, Any]]:
    """Forward and gradient of one convolution beside its dense products alone."""
    rows = []
    for vertices in config.vertices:
        operator = jax.device_put(garment_of_size(SMALL, vertices).graph.levels[0].laplacian)
        nodes = operator.shape[0]
        for width in config.features:
            params = init_cheb_conv(jax.random.key(0), config.order, width, width)
            x = jnp.ones((nodes, config.samples, width))

            def loss(params: ChebConv, x: jax.Array, operator: SparseOperator = operator) -> jax.Array:
                return (cheb_conv(params, operator, x) ** 2).sum()

            forward, _ = compiled(cheb_conv, params, operator, x)
            backward, seconds = compiled(jax.grad(loss, argnums=(0, 1)), params, x)
            a, w = jnp.ones((nodes * config.samples, config.order * width)), jnp.ones((config.order * width, width))
            floor, _ = compiled(lambda a, w: a @ w, a, w)
            floor_back, _ = compiled(lambda a, w: (a.T @ (y := a @ w), y @ w.T), a, w)
            times = measure_in_turns(
                {
                    "forward": partial(forward, params, operator, x),
                    "gradient": partial(backward, params, x),
                    "forward floor": partial(floor, a, w),
                    "gradient floor": partial(floor_back, a, w),
                },
                config.repeats,
                config.max_seconds,
            )
            rows.append(
                {"nodes": nodes, "samples": config.samples, "width": width, "order": config.order}
                | {f"{name}, ms": 1e3 * t.median for name, t in times.items()}
                | {"forward / floor": times["forward"].median / times["forward floor"].median}
                | {"gradient / floor": times["gradient"].median / times["gradient floor"].median}
                | {"compile, s": seconds}
            )
    return rows


def main(config: Config) -> None:
    """Measure, print the two tables, and keep them."""
    first, second = products(config), convolutions(config)
    print(table(first), table(second), sep="\n\n")
    if config.save:
        note = "medians of calls taken in turns; floor: the dense products alone, no sparse operator, no activation"
        print(f"wrote {write_record('layers', config, first + second, note=note)}")
