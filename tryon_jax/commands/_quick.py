"""Programs that run once: compiled as XLA compiles fastest, since compiling takes longer than running."""

import contextlib
from collections.abc import Iterator

import jax


@contextlib.contextmanager
def compiled_quickly(wanted: bool = True) -> Iterator[None]:
    """Within it, XLA leaves most optimisations out; results differ by rounding at most.

    Args:
        wanted: False for what runs long or often, such as a simulation or a batch.
    """
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", before or wanted)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)
