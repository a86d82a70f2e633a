"""The profile: kernels are found, counted and ordered."""

import jax
import jax.numpy as jnp
import pytest

from benchmarks import profile


def test_operations_of_a_call_are_counted():
    product = jax.jit(lambda x: jnp.tanh(x @ x) @ x)
    x = jnp.ones((300, 300))
    seconds, kernels = profile.record(lambda turn: product(x * (turn + 1)), calls=3)
    assert seconds > 0
    dots = [name for name in kernels if "dot" in name or "fusion" in name]
    assert dots
    assert all(len(kernels[name]) % 3 == 0 for name in dots)
    rows = profile.rows_of(profile.Config(calls=3, top=2), seconds, kernels)
    assert len(rows) == 2
    assert rows[0]["ms"] >= rows[1]["ms"] > 0


def test_an_unknown_subject_is_refused():
    with pytest.raises(ValueError, match="drapery"):
        profile.main(profile.Config(subject="drapery"))
