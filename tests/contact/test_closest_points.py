"""Closest points and signed distances against brute force and a sphere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tryon_jax.contact.closest_points import (
    closest_faces,
    closest_point_on_triangle,
    closest_points,
    follow_faces,
    point_on_faces,
)
from tryon_jax.contact.surface import Surface, build_surface, move_surface, nearest_vertices

on_triangle = jax.jit(closest_point_on_triangle)


def sphere(radius: float = 1.0, subdivisions: int = 3, dtype: type = np.float64) -> Surface:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return build_surface(np.asarray(ball.vertices, dtype), np.asarray(ball.faces))


@given(seed=st.integers(0, 10**6), flatness=st.sampled_from([1.0, 0.1, 1e-3]))
def test_closest_point_on_triangles(seed: int, flatness: float) -> None:
    """trimesh's is another implementation of the same; slivers included."""
    rng = np.random.default_rng(seed)
    triangles = rng.normal(size=(64, 3, 3))
    triangles[:, 2] = triangles[:, 0] + flatness * (triangles[:, 2] - triangles[:, 0])
    points = rng.normal(size=(64, 3)) * rng.choice([0.3, 3.0])
    with jax.enable_x64(True):
        weights = np.asarray(on_triangle(*map(jnp.asarray, (points, *triangles.transpose(1, 0, 2)))))
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-9)
    assert weights.min() > -1e-9
    ours = np.linalg.norm(points - np.einsum("pk,pkc->pc", weights, triangles), axis=1)
    theirs = np.linalg.norm(points - trimesh.triangles.closest_point(triangles, points), axis=1)
    np.testing.assert_allclose(ours, theirs, atol=1e-7)


def test_corners_edges_and_inside() -> None:
    a, b, c = (jnp.asarray([v]) for v in ([0.0, 0, 0], [1.0, 0, 0], [0.0, 1, 0]))
    for point, expected in (
        ([-1.0, -1, 2], [1.0, 0, 0]),
        ([2.0, -0.5, 0], [0.0, 1, 0]),
        ([-0.5, 3, 0], [0.0, 0, 1]),
        ([0.5, -1, 1], [0.5, 0.5, 0]),
        ([-1.0, 0.25, 1], [0.75, 0, 0.25]),
        ([1.0, 1, 0], [0.0, 0.5, 0.5]),
        ([0.25, 0.25, 7], [0.5, 0.25, 0.25]),
    ):
        np.testing.assert_allclose(closest_point_on_triangle(jnp.asarray([point]), a, b, c)[0], expected, atol=1e-6)


def brute_force(surface: Surface, points: np.ndarray) -> np.ndarray:
    triangles = np.asarray(surface.vertices)[np.asarray(surface.faces)]
    return np.array(
        [
            np.linalg.norm(
                p - trimesh.triangles.closest_point(triangles, np.tile(p, (len(triangles), 1))), axis=1
            ).min()
            for p in points
        ]
    )


def test_closest_points_against_every_triangle(x64: None) -> None:
    rng = np.random.default_rng(0)
    shape = trimesh.creation.icosphere(subdivisions=3)
    # A lumpy body.
    vertices = shape.vertices * (1 + 0.15 * np.sin(3 * shape.vertices[:, :1]) * np.cos(2 * shape.vertices[:, 1:2]))
    surface = build_surface(np.asarray(vertices), np.asarray(shape.faces))
    points = rng.normal(size=(60, 3))
    points *= rng.uniform(0.7, 1.3, size=(60, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    found = closest_points(surface, points)
    gap = np.linalg.norm(points - np.asarray(found.position), axis=1)
    np.testing.assert_allclose(gap, brute_force(surface, points), atol=1e-4)
    assert (np.abs(gap - brute_force(surface, points)) < 1e-9).mean() > 0.95


@pytest.mark.parametrize("radius", [0.1, 1.0])
def test_signed_distance_of_a_sphere(x64: None, radius: float) -> None:
    surface = sphere(radius)
    rng = np.random.default_rng(1)
    points = rng.normal(size=(200, 3))
    distance = rng.uniform(-0.3, 0.5, size=200) * radius
    points *= (radius + distance)[:, None] / np.linalg.norm(points, axis=1, keepdims=True)
    found = closest_points(surface, points)
    # The faceted sphere lies up to 0.5 % of its radius inside the round one.
    np.testing.assert_allclose(found.height, distance, atol=6e-3 * radius)
    outward = np.asarray(found.position) / np.linalg.norm(np.asarray(found.position), axis=1, keepdims=True)
    assert np.einsum("pc,pc->p", outward, np.asarray(found.normal)).min() > 0.999
    assert (np.sign(found.height) == np.sign(distance))[np.abs(distance) > 6e-3 * radius].all()


def test_following_reaches_the_closest_face(x64: None) -> None:
    """Points that slide over the surface keep their closest face without a search.

    Now and then one stays behind at a vertex, where only one of several neighbours is tried: nine of ten must arrive
    after one and a half edges. Who walks farther must search anew, as the dressing does.
    """
    surface = sphere()
    rng = np.random.default_rng(2)
    points = rng.normal(size=(100, 3))
    points *= 1.02 / np.linalg.norm(points, axis=1, keepdims=True)
    axis = np.cross(points, rng.normal(size=(100, 3)))
    axis *= 0.02 / np.linalg.norm(axis, axis=1, keepdims=True)
    face = closest_faces(surface, jnp.asarray(points), nearest_vertices(surface, points))
    follow = jax.jit(follow_faces)
    for _ in range(10):
        points = points + axis
        points *= 1.02 / np.linalg.norm(points, axis=1, keepdims=True)
        face = follow(surface, jnp.asarray(points), face)
    followed = point_on_faces(surface, jnp.asarray(points), face)
    searched = closest_points(surface, points)
    gap = [np.linalg.norm(points - np.asarray(at.position), axis=1) for at in (followed, searched)]
    assert (gap[0] - gap[1] < 1e-9).mean() >= 0.9
    assert (gap[1] - gap[0] < 1e-9).all()


def test_a_face_is_kept_unless_a_neighbour_is_nearer(x64: None) -> None:
    surface = sphere(subdivisions=1)
    faces = np.arange(80)
    centres = np.asarray(surface.vertices)[np.asarray(surface.faces)].mean(axis=1) * 1.05
    np.testing.assert_array_equal(follow_faces(surface, jnp.asarray(centres), jnp.asarray(faces)), faces)


def test_topology_of_a_surface() -> None:
    surface = sphere(subdivisions=2)
    faces, across = np.asarray(surface.faces), np.asarray(surface.adjacent_faces)
    for face in (0, 17, 100):
        for corner in range(3):
            other = across[face, corner]
            shared = set(faces[face]) & set(faces[other])
            assert shared == set(np.delete(faces[face], corner))
    ring = np.asarray(surface.vertex_faces)
    for vertex in (0, 40):
        assert set(ring[vertex]) == set(np.flatnonzero((faces == vertex).any(axis=1)))


def test_moving_a_surface_turns_its_normals() -> None:
    surface = sphere(subdivisions=2, dtype=np.float32)
    wide = move_surface(surface, surface.vertices * jnp.asarray([[3.0, 1.0, 1.0]]))
    exact = np.asarray(surface.vertices) / [3, 1, 1]
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    assert np.einsum("vc,vc->v", exact, np.asarray(wide.normals)).min() > 0.98
    assert wide.faces is surface.faces


def test_an_open_or_branching_mesh_is_refused() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    with pytest.raises(ValueError, match="closed"):
        build_surface(np.asarray(ball.vertices), np.asarray(ball.faces)[1:])
    with pytest.raises(ValueError, match="closed"):
        build_surface(np.asarray(ball.vertices), np.concatenate([ball.faces, ball.faces[:2]]))


def test_distance_has_the_normal_as_gradient(x64: None) -> None:
    surface = sphere(subdivisions=4)
    points = jnp.asarray([[0.9, 0.5, 0.3], [0.1, -1.2, 0.4]])
    face = closest_points(surface, np.asarray(points)).face

    def total(p: jax.Array) -> jax.Array:
        return point_on_faces(surface, p, face).height.sum()

    gradient = np.asarray(jax.grad(total)(points))
    outward = np.asarray(points) / np.linalg.norm(np.asarray(points), axis=1, keepdims=True)
    np.testing.assert_allclose(gradient, outward, atol=0.05)


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_nearest_vertices_by_tree_and_by_force(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is computed on a GPU is computed here too, when the backend is said to be one."""
    surface = sphere(subdivisions=3, dtype=np.float32)
    vertices = np.asarray(surface.vertices)
    points = np.random.default_rng(0).normal(size=(5000, 3)).astype(np.float32)
    expected = np.linalg.norm(points[:, None] - vertices[None], axis=2).min(axis=1)
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    found = np.asarray(nearest_vertices(surface, points))
    np.testing.assert_allclose(np.linalg.norm(points - vertices[found], axis=1), expected, atol=1e-5)
    # A point that is not finite is near nothing; it must not stop the others.
    lost = np.where(np.arange(5000)[:, None] < 3, np.nan, points)
    np.testing.assert_array_equal(np.asarray(nearest_vertices(surface, lost))[3:], found[3:])
