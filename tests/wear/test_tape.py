"""Lengths of a garment on shapes whose girth and hem are known, and their derivatives."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.wear.fit import girth_round
from tryon_jax.wear.tape import Tapes, girths_and_hem


def tube(radius, rows=6, columns=120):
    angle = 2 * np.pi * np.arange(columns) / columns
    height = np.linspace(-0.2, 0.3, rows)
    h, a = np.meshgrid(height, angle, indexing="ij")
    points = np.stack([radius * np.sin(a), h, radius * np.cos(a)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    at = [(i + p) * columns + (j + q) % columns for p, q in ((0, 0), (0, 1), (1, 1), (1, 0))]
    corners = [x.ravel() for x in at]
    faces = np.concatenate([np.stack([corners[k] for k in order], 1) for order in ((0, 1, 2), (0, 2, 3))])
    return points, faces


def tapes_of(points, faces):
    lowest = points[:, 1] == points[:, 1].min()
    everything = np.ones(len(faces), bool)
    up = np.array([0, 1, 0], np.float32)
    places = np.array([[0, 0.013, 0], [0, 5, 0]], np.float32)
    return Tapes(faces, everything, lowest, places, np.stack([up, up]), np.array(-1.0, np.float32))


def test_girths_and_hem_of_a_tube_and_their_derivatives():
    points, faces = tube(0.2)
    tapes = tapes_of(points, faces)
    measure = jax.jit(girths_and_hem)
    girth, beyond, hem = measure(tapes, jnp.asarray(points, jnp.float32))
    assert float(girth) == pytest.approx(
        girth_round(points, faces, np.array([0, 0.013, 0]), np.array([0.0, 1, 0])), 1e-4
    )
    assert float(hem) == pytest.approx(0.8)
    # The second tape lies above the tube.
    assert float(beyond) == 0

    @jax.jit
    @jax.jacfwd
    def slope(scale):
        vertices = jnp.asarray(points, jnp.float32) * jnp.stack([scale[0], scale[1], scale[0]])[None]
        return girths_and_hem(tapes, vertices)

    np.testing.assert_allclose(slope(jnp.ones(2)), [[float(girth), 0.0], [0.0, 0.0], [0.0, -0.2]], atol=2e-3)
    beside = replace(tapes, torso=points[faces].mean(axis=1)[:, 0] > 0)
    half, _, _ = measure(beside, jnp.asarray(points, jnp.float32))
    assert float(half) == pytest.approx(0.5 * float(girth), rel=0.03)
