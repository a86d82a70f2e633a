"""The networks in float64 NumPy and SciPy, written again without JAX: what results are checked against."""

from typing import Any

import jax
import numpy as np
import scipy.sparse as sp

from tryon_jax.graph import SparseOperator
from tryon_jax.nets import UNet
from tryon_jax.tryon import Garment, Stage, TryOnModel

_ACTIVATIONS = {
    "leaky_relu": lambda x: np.maximum(x, 0.1 * x),
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0.0))),
    "silu": lambda x: x / (1.0 + np.exp(-x)),
    "tanh": np.tanh,
}


def to_csr(operator: SparseOperator) -> sp.csr_array:
    """The operator's entries in float64, padding included in its shape."""
    matrix = operator.to_bcoo()
    index = np.asarray(matrix.indices)
    data = np.asarray(matrix.data, np.float64)
    return sp.coo_array((data, (index[:, 0], index[:, 1])), shape=matrix.shape).tocsr()


def double(tree: Any) -> Any:
    """All arrays as float64 on the host."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), tree)


def cheb_conv(params: Any, laplacian: sp.csr_array, x: np.ndarray) -> np.ndarray:
    """Σ T_k(L̃) x W_k + b by the three-term recursion, for one sample [N, i]."""
    terms = [x, laplacian @ x]
    for _ in range(2, len(params.weight)):
        terms.append(2.0 * (laplacian @ terms[-1]) - terms[-2])
    return sum(t @ w for t, w in zip(terms, params.weight, strict=False)) + params.bias


class ReferenceGraph:
    """Operators of one garment, converted once."""

    def __init__(self, garment: Garment) -> None:
        self.levels = [
            (to_csr(level.laplacian), level.down and to_csr(level.down), level.up and to_csr(level.up))
            for level in garment.graph.levels
        ]
        self.mask = np.asarray(garment.graph.mask)
        self.vertices = np.asarray(garment.graph.vertices, np.float64)
        self.skinning = np.asarray(garment.graph.skinning_weights, np.float64)
        self.heat = to_csr(garment.smoother.operator)
        self.coefficients = np.asarray(garment.smoother.coefficients, np.float64)

    def smooth(self, x: np.ndarray) -> np.ndarray:
        """The garment's Laplacian smoothing."""
        before, now = x, self.heat @ x
        total = self.coefficients[0] * before + self.coefficients[1] * now
        for c in self.coefficients[2:]:
            before, now = now, 2.0 * (self.heat @ now) - before
            total += c * now
        return total

    def unet(self, net: UNet, x: np.ndarray) -> np.ndarray:
        """A U-Net's outputs for one sample [N, i]; `net` from `double`."""
        config, depth = net.config, len(net.config.widths)

        def convolve(conv: Any, level: int, x: np.ndarray) -> np.ndarray:
            y = cheb_conv(conv, self.levels[level][0], x)
            if getattr(config, "normalisation", "none") == "layer":
                y = y - y.mean(axis=-1, keepdims=True)
                y = y / np.sqrt((y * y).mean(axis=-1, keepdims=True) + 1e-5)
            return _ACTIVATIONS[config.activation](y)

        skips = []
        for level, convs in enumerate(net.encoder):
            for conv in convs:
                x = convolve(conv, level, x)
            skips.append(x)
            if level + 1 < depth:
                x = self.levels[level][1] @ x
        for level in range(depth - 2, -1, -1):
            x = np.concatenate([self.levels[level][2] @ x, skips[level]], axis=-1)
            for conv in net.decoder[level]:
                x = convolve(conv, level, x)
        return cheb_conv(net.head, self.levels[0][0], x)

    def displacement(self, stage: Stage, x: np.ndarray) -> np.ndarray:
        """A stage's displacements in metres; zero at padded nodes."""
        return self.mask[:, None] * float(stage.scale) * self.unet(stage.net, x)

    def smooth_features(self, config: Any, betas: np.ndarray) -> np.ndarray:
        """Node features of R_smooth for one body shape."""
        shape = np.broadcast_to(betas / config.beta_scale, (len(self.vertices), len(betas)))
        parts = [self.vertices / config.position_scale, self.skinning / config.weight_scale, shape]
        return np.concatenate(parts, axis=1)

    def drape(self, model: TryOnModel, betas: np.ndarray, fabric: str) -> np.ndarray:
        """M_fine for one body shape, metres, padded."""
        config, betas = model.config, np.asarray(betas, np.float64)
        smoothed = self.smooth(self.vertices)
        detail, relative = self.vertices - smoothed, config.reference == "smoothed"
        m_smooth = (smoothed if relative else self.vertices) + self.displacement(
            double(model.smooth), self.smooth_features(config, betas)
        )
        shape = np.broadcast_to(betas / config.beta_scale, (len(smoothed), len(betas)))
        parts = [m_smooth / config.position_scale, self.skinning / config.weight_scale]
        parts += [shape] * config.fine_betas + [detail / config.detail_scale] * config.fine_detail
        fine = m_smooth + self.displacement(double(model.fine[fabric]), np.concatenate(parts, axis=1))
        return fine + detail if relative else fine
