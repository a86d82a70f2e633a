"""The networks of these tests are small: optimising their programs takes longer than running them."""

from collections.abc import Iterator

import jax
import pytest


@pytest.fixture(scope="module", autouse=True)
def unoptimised() -> Iterator[None]:
    """Programs of one module as XLA compiles them fastest; other folders run the same networks optimised."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", before)
