"""Penetration of shapes into a ball, and into the embedded body."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from tryon_jax.body import load_body, shape_body, vertex_normals
from tryon_jax.contact.skin import Skin
from tryon_jax.types import Body


@pytest.fixture(scope="module")
def ball() -> Body:
    """A body that is a ball of 10 cm; beta 0 adds 1 cm to its radius. A small ball beside it is its hand."""
    big, small = trimesh.creation.icosphere(4, 0.1), trimesh.creation.icosphere(2, 0.03)
    points = np.concatenate([big.vertices, small.vertices + np.array([[0.5, 0.0, 0.0]])])
    grow = np.concatenate([0.1 * big.vertices, np.zeros_like(small.vertices)])[:, :, None]
    weights = np.zeros((len(points), 2))
    weights[: len(big.vertices), 0] = weights[len(big.vertices) :, 1] = 1.0
    return Body(
        points.astype(np.float32),
        grow.astype(np.float32),
        np.full((2, len(points)), 1 / len(points), np.float32),
        weights.astype(np.float32),
        np.concatenate([big.faces, small.faces + len(big.vertices)]).astype(np.int32),
        parents=(-1, 0),
        joint_names=("pelvis", "left_hand"),
    )


def test_signed_distance_from_a_ball(ball):
    direction = np.random.default_rng(0).normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = np.linspace(0.06, 0.16, 200)[:, None]
    found = Skin.of_shape(ball, np.zeros(1)).signed_distances(radius * direction)
    np.testing.assert_allclose(found, radius[:, 0] - 0.1, atol=4e-4)
    grown = Skin.of_shape(ball, np.ones(1)).signed_distances(radius * direction)
    np.testing.assert_allclose(grown, radius[:, 0] - 0.11, atol=5e-4)


def test_shares_and_depth(ball):
    skin = Skin.of_shape(ball, np.zeros(1))
    # Three of four corners outside; the face between them passes the centre at 5 cm.
    vertices = np.array([[0.0, 0.05, -0.3], [0.3, 0.05, 0.15], [-0.3, 0.05, 0.15], [0.0, 0.05, 0.0]])
    faces = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])
    found = skin.penetration(vertices, faces)
    assert found.vertices == 0.25
    assert skin.inside_share(vertices) == 0.25
    assert found.depth == pytest.approx(0.05, abs=1e-3)
    # Of the four samples of each face only the one at its inner corner, 5 cm from the axis, is inside.
    assert found.surface == pytest.approx((1 + 3) / (4 + 12))
    clear = skin.penetration(vertices + np.array([[0.0, 0.2, 0.0]]), faces)
    assert (clear.vertices, clear.surface, clear.depth) == (0.0, 0.0, 0.0)
    assert clear.closest > 0


def test_hands_are_left_out(ball):
    assert np.isinf(Skin.of_shape(ball, np.zeros(1)).signed_distances(np.array([[0.5, 0.0, 0.0]])))[0]


def test_the_embedded_body_pushed_in_and_out():
    body = load_body()
    betas = jnp.array([1.0, -1.0])
    vertices = shape_body(body, betas)[0]
    normals = np.asarray(vertex_normals(vertices, body.faces))
    skin = Skin.of_shape(body, betas)
    torso = np.asarray(body.lbs_weights)[:, :4].sum(axis=1) > 0.9
    for offset in (-1e-3, 1e-3):
        found = skin.signed_distances((np.asarray(vertices) + offset * normals)[torso])
        assert np.isfinite(found).all()
        assert (np.sign(found) == np.sign(offset)).mean() > 0.99
        assert np.median(found) == pytest.approx(offset, abs=1e-4)
