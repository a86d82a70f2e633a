"""Bucket sizes: monotone, bounded waste, no upper end."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tryon_jax.graph.buckets import bucket_for_levels, bucket_size, padding_share


@given(st.integers(1, 300_000))
def test_smallest_bucket_that_fits(n):
    size = bucket_size(n)
    assert size >= n
    assert size % 64 == 0
    assert bucket_size(size) == size
    if n > 512:
        assert size < n * 9 / 8 + 1


def test_few_sizes_and_little_padding_between_the_smallest_and_the_largest_garment():
    counts = np.arange(1414, 3582)
    assert len({bucket_size(int(n)) for n in counts}) <= 12
    assert np.mean([padding_share(int(n)) for n in counts]) < 0.07


def test_levels_that_do_not_halve_get_a_larger_bucket():
    assert bucket_for_levels([600, 300, 150]) == bucket_size(600)
    assert bucket_for_levels([600, 600, 600]) == bucket_size(2400)


def test_bad_multiple():
    with pytest.raises(ValueError, match="multiple = 3"):
        bucket_size(100, 3)
