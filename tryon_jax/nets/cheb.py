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
    """He initialisation over all K · inputs incoming features, times `scale`; zero bias.

    Args:
        key: Random key.
        order: Number K of Chebyshev polynomials.
        inputs: Features of a node that come in.
        outputs: Features of a node that go out.
        scale: Factor of the weights.
    """
    deviation = scale * (2.0 / (order * inputs)) ** 0.5
    return ChebConv(deviation * jax.random.normal(key, (order, inputs, outputs)), jnp.zeros(outputs))


def cheb_conv(params: ChebConv, laplacian: SparseOperator, features: Float[Array, "N B i"]) -> Float[Array, "N B o"]:
    """y = Σ_k T_k(L̃) x W_k + b for node features of N nodes and B samples (body shapes) of one garment.

    The polynomial is evaluated on the narrower side: on the inputs by the three-term recursion, or, where the
    outputs are no wider, on the products x W_k by Clenshaw's recursion. Both are the same sum.

    Args:
        params: Weights.
        laplacian: Rescaled Laplacian L̃ [N, N] with eigenvalues in [−1, 1].
        features: Of nodes.
    """
    order, inputs, outputs = params.weight.shape
    weight = jnp.asarray(params.weight, features.dtype)
    bias = jnp.asarray(params.bias, features.dtype)
    # Products over the last axis only: nodes and samples stay apart, so samples may lie on several devices.
    if outputs <= inputs:
        # One product per order: a joint one would have to be sliced, which copies.
        result = _clenshaw(laplacian, [features @ weight[k] for k in range(order)])
    else:
        terms = [features]
        if order > 1:
            terms.append(apply_operator(laplacian, features))
        for _ in range(2, order):
            terms.append(2.0 * apply_operator(laplacian, terms[-1]) - terms[-2])
        result = jnp.concatenate(terms, axis=-1) @ weight.reshape(order * inputs, outputs)
    return result + bias[None, None, :]


def _clenshaw(laplacian: SparseOperator, coefficients: list[Float[Array, "N B o"]]) -> Float[Array, "N B o"]:
    """Σ_k T_k(L̃) c_k with one product fewer than there are coefficients."""
    if len(coefficients) == 1:
        return coefficients[0]
    higher, high = None, coefficients[-1]
    for coefficient in coefficients[-2:0:-1]:
        now = 2.0 * apply_operator(laplacian, high) + coefficient
        higher, high = high, now if higher is None else now - higher
    result = coefficients[0] + apply_operator(laplacian, high)
    return result if higher is None else result - higher
