"""The same two U-Nets in PyTorch Geometric: its ChebConv with the same weights, pooling by sparse matrices.

On the device that JAX uses, where PyTorch can.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np
import torch
from torch_geometric.nn import ChebConv

from tryon_jax.graph import SparseOperator
from tryon_jax.graph.smoothing import smooth
from tryon_jax.nets import UNet
from tryon_jax.tryon import Garment, TryOnModel


def _device() -> torch.device:
    on_card = jax.devices()[0].platform == "gpu" and torch.cuda.is_available()
    return torch.device("cuda" if on_card else "cpu")


def _run_there(function: Callable[[], torch.Tensor]) -> Callable[[], torch.Tensor]:
    """A call of the function on the device, which returns when that has done its work."""
    device = _device()

    def run() -> torch.Tensor:
        with torch.no_grad(), device:
            result = function()
        if device.type == "cuda":
            torch.cuda.synchronize()
        return result

    return run


def _sparse(operator: SparseOperator, rows: int, columns: int) -> torch.Tensor:
    matrix = operator.to_bcoo()
    index = torch.tensor(np.asarray(matrix.indices).T.astype(np.int64))
    return (
        torch.sparse_coo_tensor(index, torch.tensor(np.asarray(matrix.data)), (rows, columns))
        .coalesce()
        .to_sparse_csr()
    )


class PeerUNet(torch.nn.Module):
    """One U-Net on one graph, samples [B, N, C] side by side as ChebConv wants them."""

    def __init__(self, net: UNet, garment: Garment) -> None:
        super().__init__()
        self.config = net.config
        depth = len(net.config.widths)
        levels = garment.graph.levels[:depth]
        counts = [int(np.sum(level.mask)) for level in levels]
        self.edges, self.bounds = [], []
        for level, count in zip(levels, counts, strict=True):
            matrix = level.laplacian.to_bcoo()
            index, data = np.asarray(matrix.indices), np.asarray(matrix.data)
            self.edges.append(torch.tensor(index[index[:, 0] != index[:, 1]].T.astype(np.int64)))
            # The diagonal of L̃ is 2 / λ − 1 wherever a node has an edge.
            self.bounds.append(torch.tensor(2.0 / (1.0 + float(data[index[:, 0] == index[:, 1]].max()))))
            assert count <= len(level.mask)
        self.down = [_sparse(levels[i].down, counts[i + 1], counts[i]) for i in range(depth - 1)]
        self.up = [_sparse(levels[i].up, counts[i], counts[i + 1]) for i in range(depth - 1)]
        self.encoder = torch.nn.ModuleList([torch.nn.ModuleList([_conv(c) for c in convs]) for convs in net.encoder])
        self.decoder = torch.nn.ModuleList([torch.nn.ModuleList([_conv(c) for c in convs]) for convs in net.decoder])
        self.head = _conv(net.head)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[B, N, C] to [B, N, 3]."""
        skips = []
        for level, convs in enumerate(self.encoder):
            for conv in convs:
                x = self._activate(conv(x, self.edges[level], lambda_max=self.bounds[level]))
            skips.append(x)
            if level + 1 < len(self.encoder):
                x = _apply(self.down[level], x)
        for level in range(len(self.decoder) - 1, -1, -1):
            x = torch.cat([_apply(self.up[level], x), skips[level]], dim=-1)
            for conv in self.decoder[level]:
                x = self._activate(conv(x, self.edges[level], lambda_max=self.bounds[level]))
        return self.head(x, self.edges[0], lambda_max=self.bounds[0])

    def _activate(self, x: torch.Tensor) -> torch.Tensor:
        if getattr(self.config, "normalisation", "none") == "layer":
            x = torch.nn.functional.layer_norm(x, x.shape[-1:])
        return _ACTIVATIONS[self.config.activation](x)


_ACTIVATIONS: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {
    "leaky_relu": partial(torch.nn.functional.leaky_relu, negative_slope=0.1),
    "elu": torch.nn.functional.elu,
    "silu": torch.nn.functional.silu,
    "tanh": torch.tanh,
}


def peer_layer(params: Any, laplacian: SparseOperator, features: np.ndarray) -> Callable[[], Any]:
    """A call of one ChebConv with the same weights on features [N, B, i]."""
    matrix = laplacian.to_bcoo()
    index, data = np.asarray(matrix.indices), np.asarray(matrix.data)
    with _device():
        edges = torch.tensor(index[index[:, 0] != index[:, 1]].T.astype(np.int64))
        bound = torch.tensor(2.0 / (1.0 + float(data[index[:, 0] == index[:, 1]].max())))
        conv, x = _conv(params), torch.tensor(np.moveaxis(features, 0, 1).copy())
    return _run_there(lambda: conv(x, edges, lambda_max=bound))


def _conv(params: Any) -> ChebConv:
    order, inputs, outputs = params.weight.shape
    conv = ChebConv(inputs, outputs, order, normalization="sym")
    with torch.no_grad():
        for k, linear in enumerate(conv.lins):
            linear.weight.copy_(torch.tensor(np.asarray(params.weight[k]).T))
        conv.bias.copy_(torch.tensor(np.asarray(params.bias)))
    return conv


def _apply(matrix: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    samples, nodes, width = x.shape
    flat = x.transpose(0, 1).reshape(nodes, samples * width)
    return (matrix @ flat).reshape(-1, samples, width).transpose(0, 1)


def peer(model: TryOnModel, garment: Garment, betas: jax.Array) -> Callable[[], Any]:
    """A call that drapes in PyTorch Geometric with the same weights."""
    with _device():
        return _run_there(_drape(model, garment, betas))


def _drape(model: TryOnModel, garment: Garment, betas: jax.Array) -> Callable[[], torch.Tensor]:
    config, count = model.config, garment.num_vertices
    fabric = config.fabrics[0]
    fine_stage = model.fine[fabric]
    smooth_net, fine_net = PeerUNet(model.smooth.net, garment), PeerUNet(fine_stage.net, garment)
    vertices = torch.tensor(np.asarray(garment.graph.vertices)[:count])
    weights = torch.tensor(np.asarray(garment.graph.skinning_weights)[:count]) / config.weight_scale
    detail = vertices - torch.tensor(np.asarray(smooth(garment.smoother, garment.graph.vertices))[:count])
    base = vertices - detail if config.reference == "smoothed" else vertices
    shapes = torch.tensor(np.asarray(betas))
    batch = len(shapes)
    scales = float(model.smooth.scale), float(fine_stage.scale)

    def spread(x: torch.Tensor) -> torch.Tensor:
        return x.expand(batch, -1, -1)

    by_shape = shapes[:, None, :].expand(-1, count, -1) / config.beta_scale

    def run() -> torch.Tensor:
        x = torch.cat([spread(vertices / config.position_scale), spread(weights), by_shape], dim=-1)
        smoothed = base + scales[0] * smooth_net(x)
        parts = [smoothed / config.position_scale, spread(weights)]
        parts += [by_shape] if config.fine_betas else []
        parts += [spread(detail / config.detail_scale)] if config.fine_detail else []
        fine = smoothed + scales[1] * fine_net(torch.cat(parts, dim=-1))
        return fine + detail if config.reference == "smoothed" else fine

    return run


def difference(run: Callable[[], Any], ours: jax.Array) -> float:
    """Largest difference of a peer's drape from the library's, metres."""
    theirs = run().cpu().numpy()
    return float(np.abs(np.asarray(ours)[:, : theirs.shape[1]] - theirs).max())
