"""Signed distance: against shapes with a formula, against libigl, on host and device."""

import igl
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from tryon_jax.body import load_body
from tryon_jax.contact.closest_points import signed_distances
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.contact.surface import build_surface


def test_box_has_its_analytic_distance_inside_outside_and_at_corners():
    box = trimesh.creation.box(extents=(2.0, 1.0, 0.6))
    surface = ClosedSurface(box.vertices, box.faces)
    points = np.random.default_rng(0).uniform(-2, 2, (400, 3))
    q = np.abs(points) - np.array([1.0, 0.5, 0.3])
    expected = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    found = surface.closest(points)
    np.testing.assert_allclose(found.distance, expected, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(points - found.position, axis=1), np.abs(expected), atol=1e-9)
    # Going along `away` increases the distance at unit rate.
    ahead = surface.closest(points + 1e-6 * found.away)
    np.testing.assert_allclose(ahead.distance - found.distance, 1e-6, atol=1e-9)


@pytest.fixture(scope="module")
def bodies() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """An uneven blob with sharp valleys, and a person."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    blob = ball.vertices * [1.0, 0.3, 0.1] + 0.05 * np.sin(9 * ball.vertices[:, [1, 2, 0]])
    body = load_body()
    return {
        "blob": (blob, np.asarray(ball.faces)),
        "person": (np.asarray(body.v_template, np.float64), np.asarray(body.faces, np.int64)),
    }


def points_around(vertices: np.ndarray, count: int = 600) -> np.ndarray:
    """A third anywhere around, a third near the surface, a third near its vertices."""
    rng = np.random.default_rng(1)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    anywhere = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), (count, 3))
    at = vertices[rng.choice(len(vertices), 2 * count)]
    return np.concatenate([anywhere, at[:count] + rng.normal(0, 1e-2, (count, 3)), at[count:] + 1e-4])


@pytest.mark.parametrize("name", ["blob", "person"])
def test_equals_libigl(bodies, name):
    """Another implementation of the same definition."""
    vertices, faces = bodies[name]
    points = points_around(vertices)
    expected, _, position, _ = igl.signed_distance(
        points, vertices, faces, sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    )
    found = ClosedSurface(vertices, faces).closest(points)
    np.testing.assert_allclose(found.distance, expected, atol=1e-9)
    # Two points of the surface may be equally close.
    same = np.linalg.norm(found.position - position, axis=1) < 1e-6
    assert same.mean() > 0.99
    limited = ClosedSurface(vertices, faces).closest(points, exact_below=0.02).distance
    near = np.abs(expected) < 0.02
    assert near.sum() > 100
    np.testing.assert_allclose(limited[near], expected[near], atol=1e-9)


@pytest.mark.parametrize("name", ["blob", "person"])
def test_the_device_has_the_same_definition(bodies, name, x64):
    """Where both find the same face, distance and sign are equal; gradients are the unit direction away."""
    vertices, faces = bodies[name]
    points = points_around(vertices)
    found = ClosedSurface(vertices, faces).closest(points)
    surface = build_surface(vertices, faces)

    def distances(x):
        return signed_distances(surface, x, jnp.asarray(found.face))

    np.testing.assert_allclose(distances(jnp.asarray(points)), found.distance, atol=1e-9)
    gradient = jax.grad(lambda x: distances(x).sum())(jnp.asarray(points))
    clear = np.abs(found.distance) > 1e-5
    np.testing.assert_allclose(np.asarray(gradient)[clear], found.away[clear], atol=1e-4)


def test_direction_on_the_surface_itself_is_outward():
    box = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    found = ClosedSurface(box.vertices, box.faces).closest(np.array([[0.5, 0.1, 0.2], [0.5, 0.5, 0.0]]))
    np.testing.assert_allclose(found.distance, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.away, [[1, 0, 0], [0.5**0.5, 0.5**0.5, 0]], atol=1e-9)


def test_open_mesh_is_refused():
    box = trimesh.creation.box()
    with pytest.raises(ValueError, match="but 3 edges do not have two"):
        ClosedSurface(box.vertices, box.faces[1:])
