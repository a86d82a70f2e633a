"""Chebyshev graph convolution (Defferrard et al. 2016, equation 4), a pure function over its parameters."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from tryon_jax.graph.operator import SparseOperator, apply_operator
from tryon_jax.types import ArrayLike, pytree


@pytree
class ChebConv:
    """Parameters of one convolution: K filters, each a matrix from input to output features."""

    weight: Float[ArrayLike, "K i o"]
    bias: Float[ArrayLike, " o"]


def init_cheb_conv(key: PRNGKeyArray, order: int, inputs: int, outputs: int, scale: float = 1.0) -> ChebConv:
    """He initialisation over all K · inputs incoming features, times `scale`; zero bias."""
    deviation = scale * (2.0 / (order * inputs)) ** 0.5
    return ChebConv(deviation * jax.random.normal(key, (order, inputs, outputs)), jnp.zeros(outputs))


def cheb_conv(params: ChebConv, laplacian: SparseOperator, features: Float[Array, "N B i"]) -> Float[Array, "N B o"]:
    """y = Σ_k T_k(L̃) x W_k + b for node features of N nodes and B samples (body shapes) of one garment.

    The polynomial is evaluated on the narrower side: on the inputs by the three-term recursion, or, where the
    outputs are narrower, on the products x W_k by Clenshaw's recursion. Both are the same sum.
    """
    order, inputs, outputs = params.weight.shape
    weight = jnp.asarray(params.weight, features.dtype)
    bias = jnp.asarray(params.bias, features.dtype)
    nodes, samples, _ = features.shape
    if outputs < inputs and order > 1:
        projected = jnp.einsum("nbi,kio->knbo", features, weight)
        high, higher = projected[-1], None
        for k in range(order - 2, 0, -1):
            product = 2.0 * apply_operator(laplacian, high) + projected[k]
            high, higher = (product if higher is None else product - higher), high
        result = projected[0] + apply_operator(laplacian, high)
        result = result if higher is None else result - higher
        return result + bias[None, None, :]
    terms = [features]
    if order > 1:
        terms.append(apply_operator(laplacian, features))
    for _ in range(2, order):
        terms.append(2.0 * apply_operator(laplacian, terms[-1]) - terms[-2])
    stacked = jnp.concatenate(terms, axis=-1).reshape(nodes * samples, order * inputs)
    result = stacked @ weight.reshape(order * inputs, outputs)
    return result.reshape(nodes, samples, outputs) + bias[None, None, :]
