"""What `python -m benchmarks compare` measures of the networks: each subject with its check, its floor, its peers."""

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from benchmarks._garments import garment_of, model_of
from benchmarks._machine import PRECISIONS
from benchmarks._networks import layer_shapes
from benchmarks._reference import ReferenceGraph, cheb_conv, double, to_csr
from tryon_jax.graph import apply_operator
from tryon_jax.nets import PAPER, TryOnConfig, UNet, init_cheb_conv, paper_form
from tryon_jax.nets import cheb_conv as jax_cheb_conv
from tryon_jax.training.parts import default_shapes_at_once, value_and_grad_in_parts
from tryon_jax.tryon import Garment, Stage, TryOnModel, apply_stage, drape, smooth_features
from tryon_jax.tryon.precision import cast_net, with_precision
from tryon_jax.types import pytree

FRESH = 3
"""Different inputs that timed calls take in turn."""
LAYER_WIDTH = {"small": 64, "paper": 168}
"""Inputs and outputs of the Chebyshev layer."""


@dataclass(frozen=True)
class Cell:
    """One point of the comparison."""

    subject: str
    config: str
    """Size of the networks, or "" where there are none."""
    vertices: int
    batch: int
    """Body shapes in one call."""
    precision: str = "float32"


@dataclass(frozen=True, eq=False)
class Work:
    """A cell ready to be compiled, checked and timed."""

    function: Callable[..., Any]
    """Called as function(*fixed, *inputs[k])."""
    fixed: tuple[Any, ...]
    inputs: Sequence[tuple[Any, ...]]
    check: Callable[[Callable[..., Any]], float]
    """Largest difference of the compiled function from float64, in `unit`."""
    tolerance: float
    unit: str
    samples: int
    """Body shapes that one call treats."""
    flops: float
    """Floating-point operations that cannot be avoided."""
    moved: float
    """Bytes that cannot be avoided: every operand once."""
    peers: dict[str, Callable[[], Any]] = field(default_factory=dict)
    steps: int = 1
    """Simulator steps in one call."""


def config_of(cell: Cell) -> TryOnConfig:
    """The networks' configuration: the pretrained model's for "small"."""
    return paper_form(PAPER) if cell.config == "paper" else model_of(None).config


def tryon_model(cell: Cell) -> TryOnModel:
    """The pretrained model for "small", random weights for "paper"."""
    return model_of(paper_form(PAPER) if cell.config == "paper" else None)


def random_betas(cell: Cell, rng: np.random.Generator, num_betas: int) -> jax.Array:
    """Shapes as training draws them, at most 2 away."""
    return jnp.asarray(rng.uniform(-1.4, 1.4, (cell.batch, num_betas)), jnp.float32)


def work_of_layers(nets: Sequence[UNet], nodes: int, batch: int, entries: int, bytes_each: int) -> tuple[float, float]:
    """Operations and traffic of U-Nets: dense products, sparse products, each activation written and read once."""
    flops = moved = 0.0
    for net in nets:
        for n, k, i, o in layer_shapes(net, nodes):
            flops += 2.0 * n * batch * k * i * o + 2.0 * (k - 1) * entries * n / nodes * batch * min(i, o)
            moved += bytes_each * (n * batch * (i + o) + k * i * o)
    return flops, moved


def entries(garment: Garment) -> int:
    """Entries of the finest Laplacian that are not zero."""
    return int((np.asarray(garment.graph.levels[0].laplacian.rows.weights) != 0).sum()) + garment.graph.num_nodes


def generator(cell: Cell) -> np.random.Generator:
    """Of a cell's inputs: the same in every run."""
    return np.random.default_rng((cell.vertices, cell.batch))


def laplacian_product(cell: Cell) -> Work:
    """L̃ x for node features of the first layer's width."""
    config = config_of(cell)
    operator = garment_of(config, cell.vertices).graph.levels[0].laplacian
    dtype, _ = PRECISIONS[cell.precision]
    columns = cell.batch * config.smooth.widths[0]
    rng = generator(cell)
    inputs = [(jnp.asarray(rng.normal(size=(operator.shape[1], columns)), dtype),) for _ in range(FRESH)]
    csr = to_csr(operator)

    def check(run: Callable[..., Any]) -> float:
        some = np.unique(np.linspace(0, columns - 1, 16).astype(int))
        found = np.asarray(run(operator, *inputs[0]), np.float64)[:, some]
        return float(np.abs(found - csr @ np.asarray(inputs[0][0], np.float64)[:, some]).max())

    on_host, single = np.asarray(inputs[0][0], np.float32), csr.astype(np.float32)
    bcoo = operator.to_bcoo()
    bcoo_product = jax.jit(lambda m, x: m @ x)
    peers = {"SciPy CSR": lambda: single @ on_host, "JAX BCOO": lambda: bcoo_product(bcoo, inputs[0][0])}
    size = inputs[0][0].nbytes
    return Work(
        apply_operator, (operator,), inputs, check, 1e-5, "", cell.batch,
        2.0 * csr.nnz * columns, 2.0 * size + 8.0 * csr.nnz, peers,
    )  # fmt: skip


def cheb_layer(cell: Cell) -> Work:
    """One Chebyshev convolution of a middle layer's width, without activation."""
    config, width = config_of(cell), LAYER_WIDTH[cell.config]
    operator = garment_of(config, cell.vertices).graph.levels[0].laplacian
    order, nodes = config.smooth.order, operator.shape[0]
    params = init_cheb_conv(jax.random.key(1), order, width, width)
    rng = generator(cell)
    inputs = [(jnp.asarray(rng.normal(size=(nodes, cell.batch, width)), jnp.float32),) for _ in range(FRESH)]
    csr, exact = to_csr(operator), double(params)

    def check(run: Callable[..., Any]) -> float:
        found = np.asarray(run(params, operator, *inputs[0]), np.float64)
        return max(
            float(np.abs(found[:, b] - cheb_conv(exact, csr, np.asarray(inputs[0][0][:, b], np.float64))).max())
            for b in {0, cell.batch - 1}
        )

    single, on_host = csr.astype(np.float32), np.asarray(inputs[0][0])
    weight, bias = np.asarray(params.weight), np.asarray(params.bias)

    def in_scipy() -> np.ndarray:
        flat = on_host.reshape(nodes, -1)
        terms = [flat, single @ flat]
        for _ in range(2, order):
            terms.append(2.0 * (single @ terms[-1]) - terms[-2])
        return sum(t.reshape(-1, width) @ w for t, w in zip(terms, weight, strict=False)) + bias

    peers: dict[str, Callable[[], Any]] = {"SciPy and NumPy": in_scipy}
    if importlib.util.find_spec("torch_geometric"):
        from benchmarks._pyg import peer_layer

        peers["PyTorch Geometric"] = peer_layer(params, operator, on_host)
    flops = 2.0 * cell.batch * (nodes * order * width * width + (order - 1) * csr.nnz * width)
    moved = 2.0 * inputs[0][0].nbytes + params.weight.nbytes
    # Outputs are sums of hundreds of products of size one; TF32 has ten bits.
    tolerance = 1e-3 if cell.precision == "float32" else 0.05
    return Work(jax_cheb_conv, (params, operator), inputs, check, tolerance, "", cell.batch, flops, moved, peers)


def rounding_mm(found: np.ndarray, exact: np.ndarray) -> float:
    """Largest distance [N, 3], metres in and millimetres out, per metre of what is computed where that is more.

    Rounding grows with the numbers: networks that see a mesh 30 times as dense as any they were trained on send some
    vertices metres away.
    """
    largest = np.linalg.norm(exact, axis=1).max()
    return 1e3 * float(np.linalg.norm(found - exact, axis=1).max()) / max(1.0, float(largest))


def unet_forward(cell: Cell) -> Work:
    """R_smooth's displacements, metres."""
    config, model = config_of(cell), tryon_model(cell)
    garment = garment_of(config, cell.vertices)
    dtype, _ = PRECISIONS[cell.precision]
    stage = Stage(cast_net(model.smooth.net, dtype), model.smooth.scale)

    def forward(stage: Stage, garment: Garment, betas: jax.Array) -> jax.Array:
        return apply_stage(stage, garment.graph, smooth_features(config, garment, betas))

    rng = generator(cell)
    inputs = [(random_betas(cell, rng, config.num_betas),) for _ in range(FRESH)]

    def check(run: Callable[..., Any]) -> float:
        reference, exact = ReferenceGraph(garment), double(model.smooth)
        found, worst = np.asarray(run(stage, garment, *inputs[0]), np.float64), 0.0
        for b in {0, cell.batch - 1}:
            features = reference.smooth_features(config, np.asarray(inputs[0][0][b], np.float64))
            worst = max(worst, rounding_mm(found[:, b], reference.displacement(exact, features)))
        return worst

    nodes = garment.graph.num_nodes
    flops, moved = work_of_layers([stage.net], nodes, cell.batch, entries(garment), jnp.dtype(dtype).itemsize)
    tolerance = 0.01 if cell.precision == "float32" else 0.1
    return Work(forward, (stage, garment), inputs, check, tolerance, "mm", cell.batch, flops, moved)


def squares(net: UNet, config: TryOnConfig, garment: Garment, betas: jax.Array, shares: jax.Array) -> jax.Array:
    """Mean over the vertices of the squared outputs of R_smooth, weighted over the shapes."""
    outputs = apply_stage(Stage(net, jnp.ones(())), garment.graph, smooth_features(config, garment, betas))
    return ((outputs**2).sum((0, 2)) * shares).sum() / garment.graph.num_vertices


def _check_gradient(cell: Cell, net: UNet, garment: Garment, betas: jax.Array, gradient: Any, value: float) -> float:
    """Relative error of loss and gradient of the last shape alone: the slope along the gradient, in float64."""
    config, reference, exact = config_of(cell), ReferenceGraph(garment), double(net)
    features = reference.smooth_features(config, np.asarray(betas[-1], np.float64))

    def loss(net: UNet) -> float:
        return float(((reference.mask[:, None] * reference.unet(net, features)) ** 2).sum() / garment.num_vertices)

    slope = double(gradient)
    norm = np.sqrt(sum((leaf**2).sum() for leaf in jax.tree.leaves(slope)))
    step = 1e-5 / norm

    def moved(by: float) -> float:
        return loss(jax.tree.map(lambda w, g: w + by * g / norm, exact, slope))

    wrong = abs((moved(step) - moved(-step)) / (2 * step) / norm - 1)
    return float(max(wrong, abs(value / loss(exact) - 1)))


def unet_gradient(cell: Cell) -> Work:
    """Value and gradient of a loss by all weights of R_smooth."""
    config, net = config_of(cell), tryon_model(cell).smooth.net
    garment = garment_of(config, cell.vertices)

    def run(net: UNet, garment: Garment, betas: jax.Array, shares: jax.Array) -> tuple[jax.Array, Any]:
        return jax.value_and_grad(squares)(net, config, garment, betas, shares)

    rng = generator(cell)
    even = jnp.full(cell.batch, 1 / cell.batch, jnp.float32)
    inputs = [(random_betas(cell, rng, config.num_betas), even) for _ in range(FRESH)]

    def check(made: Callable[..., Any]) -> float:
        last = jnp.zeros(cell.batch).at[-1].set(1.0)
        value, gradient = made(net, garment, inputs[0][0], last)
        return _check_gradient(cell, net, garment, inputs[0][0], gradient, float(value))

    flops, moved = work_of_layers([net], garment.graph.num_nodes, cell.batch, entries(garment), 4)
    return Work(run, (net, garment), inputs, check, 1e-2, "relative", cell.batch, 3 * flops, 3 * moved)


@pytree
class _Shapes:
    """A batch in the form that `value_and_grad_in_parts` divides."""

    BY_SHAPE = ("betas", "shares")

    garments: Garment
    betas: Float[Array, "G B b"]
    shares: Float[Array, "G B"]


def training_step(cell: Cell) -> Work:
    """Gradient and AdamW of R_smooth, as many shapes at once as training takes here; weights go in and come out."""
    config, net = config_of(cell), tryon_model(cell).smooth.net
    garment = garment_of(config, cell.vertices)
    optimiser = optax.adamw(1e-3, weight_decay=1e-5)

    def loss(net: UNet, batch: _Shapes) -> jax.Array:
        # The mean over parts of the batch is to be the sum that `shares` weights.
        parts = cell.batch / batch.betas.shape[1]
        own = jax.tree.map(lambda leaf: leaf[0], batch.garments)
        return parts * squares(net, config, own, batch.betas[0], batch.shares[0])

    def step(net: UNet, state: Any, garment: Garment, betas: jax.Array, shares: jax.Array) -> tuple[Any, ...]:
        batch = _Shapes(jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], garment), betas[None], shares[None])
        value, gradient = value_and_grad_in_parts(loss, default_shapes_at_once())(net, batch)
        updates, state = optimiser.update(gradient, state, net)
        return optax.apply_updates(net, updates), state, value

    state = jax.jit(optimiser.init)(net)
    rng = generator(cell)
    even = jnp.full(cell.batch, 1 / cell.batch, jnp.float32)
    inputs = [(random_betas(cell, rng, config.num_betas), even) for _ in range(FRESH)]

    def check(made: Callable[..., Any]) -> float:
        last = jnp.zeros(cell.batch).at[-1].set(1.0)
        _, after, value = made(net, state, garment, inputs[0][0], last)
        # Adam's first moment after one step is a tenth of the gradient.
        [moments] = [s.mu for s in jax.tree.leaves(after, is_leaf=lambda s: hasattr(s, "mu")) if hasattr(s, "mu")]
        gradient = jax.tree.map(lambda moment: 10 * moment, moments)
        return _check_gradient(cell, net, garment, inputs[0][0], gradient, float(value))

    flops, moved = work_of_layers([net], garment.graph.num_nodes, cell.batch, entries(garment), 4)
    return Work(step, (net, state, garment), inputs, check, 1e-2, "relative", cell.batch, 3 * flops, 3 * moved)


def whole_drape(cell: Cell) -> Work:
    """Both U-Nets from betas to vertices, as users call it."""
    config, model = config_of(cell), tryon_model(cell)
    garment, fabric = garment_of(config, cell.vertices), config.fabrics[0]
    dtype, _ = PRECISIONS[cell.precision]
    used = model if cell.precision != "bfloat16" else with_precision(model, dtype)
    rng = generator(cell)
    inputs = [(random_betas(cell, rng, config.num_betas),) for _ in range(FRESH)]
    run = partial(drape, fabric=fabric)

    def check(made: Callable[..., Any]) -> float:
        reference, worst = ReferenceGraph(garment), 0.0
        found = np.asarray(made(used, garment, *inputs[0]), np.float64)
        for b in {0, cell.batch - 1}:
            exact = reference.drape(model, np.asarray(inputs[0][0][b]), fabric)[reference.mask]
            worst = max(worst, rounding_mm(found[b][reference.mask], exact))
        return worst

    peers: dict[str, Callable[[], Any]] = {}
    if importlib.util.find_spec("torch_geometric") and cell.precision == "float32":
        from benchmarks._pyg import peer

        peers["PyTorch Geometric"] = peer(model, garment, inputs[0][0])
    nets = [model.smooth.net, model.fine[fabric].net]
    nodes = garment.graph.num_nodes
    flops, moved = work_of_layers(nets, nodes, cell.batch, entries(garment), jnp.dtype(dtype).itemsize)
    tolerance = 0.01 if cell.precision == "float32" else 0.1
    return Work(run, (used, garment), inputs, check, tolerance, "mm", cell.batch, flops, moved, peers)
