"""Loss and gradient of a batch, a few body shapes at a time.

A training step on a CPU is bound by memory: what one pass over a whole batch stores for the backward pass is tens of
megabytes at every layer. One drape stays in the cache, and the mean of its gradients is the same.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from tryon_jax.checks import check_range

Params = Any
Batch = Any
ValueAndGrad = Callable[[Params, Batch], tuple[jax.Array, Params]]


def varies_by_shape(batch: Batch) -> list[bool]:
    """Whether axis 1 is the body shapes, for each leaf: those in the fields that the batch lists in `BY_SHAPE`."""
    fields = getattr(batch, "BY_SHAPE", ())
    leaves, _ = jax.tree_util.tree_flatten_with_path(batch)
    return [bool(path) and getattr(path[0], "name", None) in fields for path, _ in leaves]


def value_and_grad_in_parts(loss: Callable[[Params, Batch], jax.Array], shapes: int) -> ValueAndGrad:
    """As `jax.value_and_grad(loss)`, for a loss that is a mean over garments (axis 0) and body shapes.

    Args:
        loss: of parameters and a batch. A batch of which nothing `varies_by_shape` is not divided.
        shapes: body shapes of one garment at a time (the largest divisor of their number that is no larger);
            0 for the whole batch.

    Raises:
        ValueError: a negative number of shapes.
    """
    check_range("shapes at once", shapes, 0, 1 << 20)
    whole = jax.value_and_grad(loss)
    if not shapes:
        return whole

    def divided(params: Params, batch: Batch) -> tuple[jax.Array, Params]:
        leaves, structure = jax.tree.flatten(batch)
        varies = varies_by_shape(batch)
        if not any(varies):
            return whole(params, batch)
        arrays = [jnp.asarray(leaf) for leaf in leaves]
        garments, count = arrays[varies.index(True)].shape[:2]
        at_once = max(k for k in range(1, min(shapes, count) + 1) if count % k == 0)

        def cut(array: jax.Array) -> jax.Array:
            return array.reshape(garments, count // at_once, 1, at_once, *array.shape[2:])

        def of_garment(total: Any, own: list[jax.Array]) -> tuple[Any, None]:
            def of_part(total: Any, part: list[jax.Array]) -> tuple[Any, None]:
                parts = iter(part)
                mixed = [next(parts) if v else leaf[None] for v, leaf in zip(varies, own, strict=True)]
                result = whole(params, jax.tree.unflatten(structure, mixed))
                return jax.tree.map(jnp.add, total, result), None

            return jax.lax.scan(of_part, total, [leaf for v, leaf in zip(varies, own, strict=True) if v])[0], None

        rows = [cut(leaf) if v else leaf for v, leaf in zip(varies, arrays, strict=True)]
        zero = jax.tree.map(lambda leaf: jnp.zeros(jnp.shape(leaf), jnp.result_type(leaf)), params)
        start = (jnp.zeros((), jax.eval_shape(loss, params, batch).dtype), zero)
        total, _ = jax.lax.scan(of_garment, start, rows)
        return jax.tree.map(lambda leaf: leaf / (garments * (count // at_once)), total)

    return divided


def default_shapes_at_once() -> int:
    """One on a CPU, where memory is slow and caches are large; all on other devices, which need much work at once."""
    return 1 if jax.default_backend() == "cpu" else 0
