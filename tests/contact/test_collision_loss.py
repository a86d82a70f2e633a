"""Collision loss: the formula, the walk against brute force, derivatives, padding."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial import cKDTree

from tryon_jax.body import load_body, shape_body, vertex_normals
from tryon_jax.contact.collision_loss import closest_vertices, collision_depths, collision_loss, list_neighbours
from tryon_jax.contact.surface import closest_vertices_exact


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture(scope="module")
def neighbours(body):
    return list_neighbours(body)


@pytest.fixture(scope="module")
def cloth(body):
    """Points about the torso and arms, up to 4 cm outside and 1 cm inside, with their start on the mean body."""
    rng = np.random.default_rng(0)
    vertices = np.asarray(body.v_template)
    chosen = rng.choice(np.flatnonzero(np.abs(vertices[:, 1]) < 0.5), 500, replace=False)
    normals = np.asarray(vertex_normals(vertices, body.faces))
    points = vertices[chosen] + normals[chosen] * rng.uniform(-0.01, 0.04, 500)[:, None]
    return points.astype(np.float32), cKDTree(vertices).query(points)[1].astype(np.int32)


@pytest.mark.parametrize("betas", [(0.0, 0.0), (2.0, -1.0), (-1.5, 2.0)])
def test_walk_finds_what_brute_force_finds_near_the_skin(body, neighbours, cloth, betas):
    points, start = cloth
    shaped = shape_body(body, jnp.asarray(betas, jnp.float32))[0]
    moved = jnp.asarray(points + (np.asarray(shaped) - np.asarray(body.v_template))[start])
    walked, rested = jax.jit(closest_vertices)(neighbours, shaped, moved, start)
    distance, exact = cKDTree(np.asarray(shaped)).query(moved)
    assert exact.shape == (500,)

    def reached(index):
        return np.linalg.norm(np.asarray(moved) - np.asarray(shaped)[np.asarray(index)], axis=1)

    # Distances and not indices: two body vertices can be equally far to float32.
    np.testing.assert_allclose(reached(closest_vertices_exact(shaped, moved, block=128)), distance, atol=1e-5)
    near = distance < 0.01
    assert near.mean() > 0.3
    np.testing.assert_allclose(reached(walked)[near], distance[near], atol=1e-6)
    assert (reached(walked) > distance + 1e-6).mean() < 0.015
    assert np.asarray(rested).mean() > 0.99


def test_walk_that_is_too_short_says_so(body, neighbours):
    points = jnp.asarray(body.v_template)[:50]
    start = np.full(50, 6000, np.int32)
    _, rested = closest_vertices(neighbours, jnp.asarray(body.v_template), points, start, steps=1)
    assert not np.asarray(rested).any()


def test_depth_is_the_papers_formula():
    body_vertices = jnp.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    normals = jnp.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    points = jnp.array([[0.1, -0.2, 0.0], [0.1, 0.2, 0.0], [1.0, 5.0, -0.3]])
    closest = jnp.array([0, 0, 1])
    np.testing.assert_allclose(collision_depths(points, body_vertices, normals, closest), [0.2, 0.0, 0.3], atol=1e-7)
    with_margin = collision_depths(points, body_vertices, normals, closest, margin=0.25)
    np.testing.assert_allclose(with_margin, [0.45, 0.05, 0.55], atol=1e-7)


def test_loss_ignores_padding_and_measures(body, neighbours, cloth):
    points, start = cloth
    vertices = jnp.asarray(body.v_template)
    normals = vertex_normals(vertices, body.faces)
    loss, measured = collision_loss(jnp.asarray(points), np.ones(500, bool), vertices, normals, neighbours, start)
    depths = np.maximum(-(np.asarray(normals)[start] * (points - np.asarray(vertices)[start])).sum(1), 0)
    assert float(loss) == pytest.approx(depths.mean(), rel=1e-4)
    assert float(measured["inside"]) == pytest.approx((depths > 0).mean())
    assert float(measured["deepest"]) == pytest.approx(depths.max(), rel=1e-4)
    assert float(measured["unsettled"]) == 0.0
    padded = np.concatenate([points, np.zeros((12, 3), np.float32)])
    more = np.concatenate([start, np.zeros(12, np.int32)])
    again, _ = collision_loss(jnp.asarray(padded), np.arange(512) < 500, vertices, normals, neighbours, more)
    assert float(again) == pytest.approx(float(loss), rel=1e-6)


def test_gradients_by_points_and_by_betas(x64, body, neighbours, cloth):
    points, start = cloth
    # Away from the kink at depth zero and from ties between body vertices, where there is no derivative.
    normals = np.asarray(vertex_normals(np.asarray(body.v_template, float), body.faces))
    deep = points.astype(float) - 0.02 * normals[start]
    deep, start = deep[:40], start[:40]

    def loss(points, betas):
        shaped = shape_body(body, jnp.asarray(betas))[0]
        depths = collision_depths(jnp.asarray(points), shaped, vertex_normals(shaped, body.faces), jnp.asarray(start))
        return depths.sum()

    check_grads(loss, (jnp.asarray(deep), jnp.array([0.3, -0.4])), order=1, modes=("rev",), atol=1e-4, rtol=1e-4)


def test_descending_the_loss_brings_cloth_out(body, neighbours, cloth):
    points, start = cloth
    vertices = jnp.asarray(body.v_template)
    normals = vertex_normals(vertices, body.faces)

    def loss(points):
        value, _ = collision_loss(points, np.ones(500, bool), vertices, normals, neighbours, start)
        return value * 500

    at = jnp.asarray(points)
    before = loss(at)
    descend = jax.jit(jax.value_and_grad(loss))
    for _ in range(30):
        at = at - 5e-4 * descend(at)[1]
    assert float(loss(at)) < 0.1 * float(before)
