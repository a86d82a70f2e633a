"""Sorting of edge keys: the same as NumPy's, only faster."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tryon_jax.mesh.topology import border_edges, stable_order, unique_edges, unique_keys

keys = st.lists(st.integers(0, 2**62), max_size=40).map(lambda values: np.array(values, np.int64))
few = st.lists(st.integers(0, 5), max_size=40).map(lambda values: np.array(values, np.int64))


@given(st.one_of(keys, few))
def test_keys_are_sorted_as_numpy_does(values: np.ndarray) -> None:
    np.testing.assert_array_equal(unique_keys(values), np.unique(values))
    np.testing.assert_array_equal(stable_order(values), np.argsort(values, kind="stable"))


@pytest.mark.parametrize("faces", [[[0, 1, 2]], [[0, 1, 2], [2, 1, 3]], [[0, 1, 2], [2, 1, 3], [3, 1, 4], [1, 2, 5]]])
def test_borders_are_the_edges_of_one_face(faces: list[list[int]]) -> None:
    array = np.array(faces)
    edges, counts = unique_edges(array, 6)
    border = border_edges(array, 6)
    np.testing.assert_array_equal(np.sort(np.sort(border, axis=1), axis=0), np.sort(edges[counts == 1], axis=0))
    directed = {tuple(map(int, row)) for face in array for row in (face[[0, 1]], face[[1, 2]], face[[2, 0]])}
    assert {tuple(map(int, row)) for row in border} <= directed
