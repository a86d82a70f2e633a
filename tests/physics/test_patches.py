"""Patches of the flat pattern."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tryon_jax.physics.patches import MOST_PATCHES, PATCH, make_patches


@given(count=st.integers(0, 300), panels=st.integers(1, 5), spare=st.integers(0, 3), seed=st.integers(0, 99))
@settings(max_examples=30)
def test_every_vertex_has_one_patch(count, panels, spare, seed):
    rng = np.random.default_rng(seed)
    padded = count + 20 * spare
    patches = make_patches(rng.uniform(size=(count, 2)), rng.integers(0, panels, count), padded)
    members, patch = np.asarray(patches.members), np.asarray(patches.patch)
    assert sorted(members[members < padded]) == list(range(count))
    sizes = (members < padded).sum(1)
    assert np.ptp(sizes) <= 1
    assert len(members) * PATCH >= padded
    assert (patch[count:] == len(members)).all()
    for number, row in enumerate(members):
        assert (patch[row[row < padded]] == number).all()


def test_patches_are_compact_and_keep_to_a_panel():
    side = np.linspace(0, 1, 16)
    square = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    # Two panels that lie on top of each other in the plane.
    patches = make_patches(np.concatenate([square, square]), np.repeat([0, 1], 256), 512)
    for row in np.asarray(patches.members):
        assert np.ptp(row // 256) == 0
        assert np.ptp(square[row % 256], axis=0).max() < 0.5


def test_large_cloths_have_larger_patches_not_more():
    places = np.random.default_rng(0).uniform(size=(20_000, 2))
    members = np.asarray(make_patches(places, np.zeros(20_000, int), 20_480).members)
    assert members.shape == (MOST_PATCHES, 80)
    assert sorted(members[members < 20_480]) == list(range(20_000))
