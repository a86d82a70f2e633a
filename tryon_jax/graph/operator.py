"""The one sparse product of the library: a linear operator on node features and `apply_operator`.

An operator is handed over as `BCOO` (or SciPy) and executed as padded neighbour lists: `slots` holds the first few
entries of every row, `tail` the rest of the few rows that have more, and both exist for the transpose too, so that
neither direction of differentiation ever scatters over the whole matrix. The product is a JAX primitive because
it must be linear for `jvp`, `vjp` and `linearize` alike, and because `vmap` must fold into it: a batch of features
becomes more columns, a batch of garments becomes one larger operator.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jax.core import ShapedArray
from jax.experimental.sparse import BCOO
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float, Int

from tryon_jax.types import ArrayLike, pytree, static


@pytree
class NeighbourLists:
    """Rows of a sparse matrix, padded: row i is the sum of `weights[k, i] x[columns[k, i]]` plus its tail.

    Padding has weight 0 and column 0; unused tail rows have `tail_rows` equal to the number of rows.
    """

    columns: Int[ArrayLike, "*batch K M"]
    weights: Float[ArrayLike, "*batch K M"]
    tail_rows: Int[ArrayLike, "*batch R"]
    """Rows with more than K entries."""
    tail_columns: Int[ArrayLike, "*batch S R"]
    tail_weights: Float[ArrayLike, "*batch S R"]
    tail_places: Int[ArrayLike, "*batch M"]
    """Where each row stands among `tail_rows`; R for those that do not."""


@pytree
class SparseOperator:
    """A constant linear map from N to M nodes, ready to run forward and transposed.

    Derivatives with respect to the entries are zero by definition; node features are differentiable in every mode.
    """

    rows: NeighbourLists
    """The off-diagonal entries by row where `diagonal` is given, else all entries."""
    columns: NeighbourLists | None
    """The same by column (the transpose), or None where the operator is symmetric."""
    diagonal: Float[ArrayLike, "*batch N"] | None
    """Diagonal of a square operator, or None."""
    shape: tuple[int, int] = static(default=(0, 0))
    """(M, N), padding included."""

    def to_bcoo(self) -> BCOO:
        """The operator as `BCOO` with sorted, unique indices and no padding; host side, one garment."""
        csr = _lists_to_csr(self.rows, self.shape)
        if self.diagonal is not None:
            csr = csr + sp.diags_array(np.asarray(self.diagonal), shape=self.shape)
        return _csr_to_bcoo(csr.tocsr())

    @property
    def transpose(self) -> "SparseOperator":
        """The transposed operator; shares all arrays with this one."""
        if self.columns is None:
            return self
        return SparseOperator(self.columns, self.rows, self.diagonal, (self.shape[1], self.shape[0]))


def _csr_to_bcoo(csr: sp.csr_array) -> BCOO:
    csr.sum_duplicates()
    csr.eliminate_zeros()
    coo = csr.tocoo()
    indices = np.stack(coo.coords, axis=1).astype(np.int32)
    return BCOO(
        (jnp.asarray(coo.data), jnp.asarray(indices)), shape=csr.shape, indices_sorted=True, unique_indices=True
    )


def _lists_to_csr(lists: NeighbourLists, shape: tuple[int, int]) -> sp.csr_array:
    columns, weights = np.asarray(lists.columns), np.asarray(lists.weights)
    tail_rows, tail_weights = np.asarray(lists.tail_rows), np.asarray(lists.tail_weights)
    rows = np.broadcast_to(np.arange(shape[0]), columns.shape)
    more = np.broadcast_to(tail_rows, tail_weights.shape)
    data = np.concatenate([weights.ravel(), tail_weights.ravel()])
    row = np.concatenate([rows.ravel(), more.ravel()])
    column = np.concatenate([columns.ravel(), np.asarray(lists.tail_columns).ravel()])
    keep = data != 0
    return sp.coo_array((data[keep], (row[keep], column[keep])), shape=shape).tocsr()


def _grown(needed: int, capacity: int) -> int:
    """The capacity, doubled until it holds what is needed."""
    while capacity < needed:
        capacity = max(2 * capacity, 1)
    return capacity


def _csr_to_lists(
    csr: sp.csr_array, num_rows: int, slots: int, tail: tuple[int, int], dtype: np.dtype
) -> NeighbourLists:
    """Pad a matrix to `num_rows` rows of `slots` entries and a tail of (rows, entries), grown where too small."""
    degree = np.diff(csr.indptr)
    row = np.repeat(np.arange(csr.shape[0]), degree)
    place = np.arange(csr.nnz) - np.repeat(csr.indptr[:-1], degree)
    long = np.flatnonzero(degree > slots)
    # A row never has an empty tail: shapes of size zero would be one more case everywhere.
    tail_size = _grown(max(len(long), 1), tail[0])
    tail_slots = _grown(int(max(degree.max(initial=0) - slots, 1)), tail[1])
    columns = np.zeros((slots, num_rows), np.int32)
    weights = np.zeros((slots, num_rows), dtype)
    first = place < slots
    columns[place[first], row[first]] = csr.indices[first]
    weights[place[first], row[first]] = csr.data[first]
    tail_rows = np.full(tail_size, num_rows, np.int32)
    tail_rows[: len(long)] = long
    tail_places = np.full(num_rows, tail_size, np.int32)
    tail_places[long] = np.arange(len(long))
    tail_columns = np.zeros((tail_slots, tail_size), np.int32)
    tail_weights = np.zeros((tail_slots, tail_size), dtype)
    rest = ~first
    at = np.searchsorted(long, row[rest])
    tail_columns[place[rest] - slots, at] = csr.indices[rest]
    tail_weights[place[rest] - slots, at] = csr.data[rest]
    return NeighbourLists(columns, weights, tail_rows, tail_columns, tail_weights, tail_places)


def make_operator(
    matrix: sp.sparray | BCOO,
    shape: tuple[int, int] | None = None,
    *,
    slots: int = 8,
    tail: tuple[int, int] = (1, 1),
    transposed_slots: int | None = None,
    transposed_tail: tuple[int, int] = (1, 1),
    split_diagonal: bool = False,
    dtype: np.dtype | type = np.float32,
) -> SparseOperator:
    """Prepare a sparse matrix [m, n] for `apply_operator`, padded with zeros to `shape` (M, N); host side.

    `slots` and `tail` are capacities: a matrix that does not fit gets larger ones, which is correct but compiles anew.
    The diagonal of a symmetric matrix is kept apart.

    Args:
        matrix: The sparse matrix [m, n].
        shape: Size (M, N) of the result; that of the matrix when None.
        slots: Entries of a row.
        tail: Number of rows with more entries than `slots`, and how many more.
        transposed_slots: The same as `slots` for the transpose; None says that the matrix is symmetric (checked).
        transposed_tail: The same as `tail` for the transpose.
        split_diagonal: Keep the diagonal of another square matrix apart too.
        dtype: Of the values.

    Raises:
        ValueError: `shape` is smaller than the matrix, or the matrix was said to be symmetric and is not.
    """
    csr = _as_csr(matrix)
    rows, columns = shape or csr.shape
    if rows < csr.shape[0] or columns < csr.shape[1]:
        raise ValueError(f"an operator of shape {csr.shape} does not fit into the padded shape {(rows, columns)}")
    dtype = np.dtype(dtype)
    symmetric = transposed_slots is None
    if (symmetric or split_diagonal) and rows != columns:
        raise ValueError(f"an operator of shape {(rows, columns)} is not square: it has no diagonal to keep apart")
    if symmetric and abs(csr - csr.T).max() > 1e-12 * abs(csr).max():
        raise ValueError("an operator without transposed lists must be symmetric")
    diagonal = None
    if symmetric or split_diagonal:
        diagonal = np.zeros(rows, dtype)
        diagonal[: csr.shape[0]] = csr.diagonal()
        csr = csr.copy()
        csr.setdiag(0)
        csr.eliminate_zeros()
    forward = _csr_to_lists(csr, rows, slots, tail, dtype)
    if transposed_slots is None:
        return SparseOperator(forward, None, diagonal, (rows, columns))
    backward = _csr_to_lists(csr.T.tocsr(), columns, transposed_slots, transposed_tail, dtype)
    return SparseOperator(forward, backward, diagonal, (rows, columns))


def _as_csr(matrix: sp.sparray | BCOO) -> sp.csr_array:
    if isinstance(matrix, BCOO):
        indices = np.asarray(matrix.indices)
        return sp.coo_array((np.asarray(matrix.data), (indices[:, 0], indices[:, 1])), shape=matrix.shape).tocsr()
    csr = sp.csr_array(matrix)
    csr.sort_indices()
    return csr


def apply_operator(operator: SparseOperator | BCOO, features: Float[ArrayLike, " N *rest"]) -> Float[Array, " M *rest"]:
    """The product of a sparse operator with node features [N, ...], differentiable in the features in every mode.

    Args:
        operator: From `make_operator`, or any `BCOO` matrix [M, N] (executed as it is).
        features: Node features; the axes behind the first one are all columns of the product.
    """
    features = jnp.asarray(features)
    flat = features.reshape(features.shape[0], -1)
    if isinstance(operator, BCOO):
        product = operator @ flat
        return product.reshape(product.shape[0], *features.shape[1:])
    # The entries are constants: without this, differentiating a whole garment would ask for their tangents.
    operator = jax.lax.stop_gradient(operator)
    leaves = [*jax.tree.leaves(operator.rows), *jax.tree.leaves(operator.columns or operator.rows)]
    product = _product.bind(*leaves, flat)
    if operator.diagonal is not None:
        product = product + jnp.asarray(operator.diagonal, flat.dtype)[:, None] * flat
    return product.reshape(product.shape[0], *features.shape[1:])


# --- the primitive: operands are six arrays of the rows, six of the columns, and features [N, C] -----------------

_product = Primitive("tryon_jax_sparse_product")
_NUM_LISTS = 6


def _gather_sum(columns: Any, weights: Any, features: Any) -> Array:
    """Σ_k weights[k] features[columns[k]]: one loop over the result that reads every neighbour."""
    return (weights.astype(features.dtype)[:, :, None] * _take_rows(features, columns)).sum(axis=0)


def _take_rows(features: Any, rows: Any) -> Array:
    """`features[rows]` without what indexing does before it, which is slow to trace."""
    dimensions = jax.lax.GatherDimensionNumbers((rows.ndim,), collapsed_slice_dims=(0,), start_index_map=(0,))
    return jax.lax.gather(features, rows[..., None], dimensions, (1, features.shape[1]), mode="promise_in_bounds")


@jax.jit
def _gather_sum_alone(columns: Any, weights: Any, features: Any) -> Array:
    """`_gather_sum` behind a branch that is always taken.

    On the CPU, XLA fuses the gathers with whatever produces or uses them and then evaluates that once per
    neighbour. It does not fuse across a branch whose condition is data; optimisation barriers do not stop it.
    """
    zeros = jnp.zeros((columns.shape[1], features.shape[1]), features.dtype)
    return jax.lax.cond(columns[0, 0] >= 0, _gather_sum, lambda *_: zeros, columns, weights, features)


def _execute_on_cpu(*operands: Any) -> Array:
    columns, weights, tail_rows, tail_columns, tail_weights, _ = operands[:_NUM_LISTS]
    features = operands[-1]
    product = _gather_sum_alone(columns, weights, features)
    return product.at[tail_rows].add(_gather_sum_alone(tail_columns, tail_weights, features), mode="drop")


def _execute_in_one(*operands: Any) -> Array:
    """For devices on which starting a kernel costs more than its arithmetic: all rows read a tail, which is zeros for
    most."""
    columns, weights, _, tail_columns, tail_weights, places = operands[:_NUM_LISTS]
    features = operands[-1]
    own_columns = tail_columns.at[:, places].get(mode="fill", fill_value=0)
    own_weights = tail_weights.at[:, places].get(mode="fill", fill_value=0)
    return _unrolled_sum(columns, weights, features) + _unrolled_sum(own_columns, own_weights, features)


def _unrolled_sum(columns: Any, weights: Any, features: Any) -> Array:
    """`_gather_sum` without a reduction, which GPUs may run as a kernel of its own."""
    total = jnp.zeros((columns.shape[1], features.shape[1]), features.dtype)
    for column, weight in zip(columns, weights.astype(features.dtype), strict=True):
        total = total + weight[:, None] * _take_rows(features, column)
    return total


def _transpose(cotangent: Any, *operands: Any) -> list[Any]:
    if type(cotangent) is ad.Zero:
        return [None] * len(operands)
    rows, columns = operands[:_NUM_LISTS], operands[_NUM_LISTS : 2 * _NUM_LISTS]
    return [None] * (2 * _NUM_LISTS) + [_product.bind(*columns, *rows, cotangent)]


def _jvp(primals: Sequence[Any], tangents: Sequence[Any]) -> tuple[Any, Any]:
    product = _product.bind(*primals)
    tangent = tangents[-1]
    if type(tangent) is ad.Zero:
        return product, ad.Zero.from_primal_value(product)  # pyright: ignore[reportAttributeAccessIssue]
    return product, _product.bind(*primals[:-1], tangent)


def _batch(operands: Sequence[Any], axes: Sequence[int | None]) -> tuple[Any, int]:
    *lists, features = operands
    if all(axis is None for axis in axes[:-1]):
        # A batch of features is a wider matrix of features.
        features = jnp.moveaxis(features, axes[-1] or 0, 1)
        count, width = features.shape[1:]
        product = _product.bind(*lists, features.reshape(features.shape[0], -1))
        return product.reshape(-1, count, width), 1
    # A batch of operators is one block-diagonal operator.
    count = next(a.shape[axis] for a, axis in zip(operands, axes, strict=True) if axis is not None)

    def leading(operand: Any, axis: int | None) -> Any:
        return jnp.broadcast_to(operand, (count, *operand.shape)) if axis is None else jnp.moveaxis(operand, axis, 0)

    *lists, features = [leading(a, axis) for a, axis in zip(operands, axes, strict=True)]
    num_rows, num_columns = lists[0].shape[-1], lists[_NUM_LISTS].shape[-1]
    joined = _join_lists(lists[:_NUM_LISTS], num_rows, num_columns)
    joined_back = _join_lists(lists[_NUM_LISTS:], num_columns, num_rows)
    product = _product.bind(*joined, *joined_back, features.reshape(count * num_columns, -1))
    return product.reshape(count, num_rows, -1), 0


def _join_lists(lists: Sequence[Any], num_rows: int, num_columns: int) -> list[Any]:
    columns, weights, tail_rows, tail_columns, tail_weights, tail_places = lists
    count, num_tails = columns.shape[0], tail_rows.shape[1]
    offset = jnp.arange(count, dtype=columns.dtype)

    def flatten(slots: Any) -> Any:
        return jnp.swapaxes(slots, 0, 1).reshape(slots.shape[1], -1)

    rows = jnp.where(tail_rows < num_rows, tail_rows + (offset * num_rows)[:, None], count * num_rows)
    shift = (offset * num_columns)[:, None, None]
    places = jnp.where(tail_places < num_tails, tail_places + (offset * num_tails)[:, None], count * num_tails)
    tail = (rows.reshape(-1), flatten(tail_columns + shift), flatten(tail_weights), places.reshape(-1))
    return [flatten(columns + shift), flatten(weights), *tail]


def _abstract(*operands: Any) -> ShapedArray:
    columns, features = operands[0], operands[-1]
    return ShapedArray((columns.shape[-1], features.shape[1]), features.dtype)


_product.def_impl(jax.jit(_product.bind))
_product.def_abstract_eval(_abstract)
ad.primitive_jvps[_product] = _jvp
ad.primitive_transposes[_product] = _transpose
batching.primitive_batchers[_product] = _batch
mlir.register_lowering(_product, mlir.lower_fun(_execute_in_one, multiple_results=False))
mlir.register_lowering(_product, mlir.lower_fun(_execute_on_cpu, multiple_results=False), platform="cpu")
