"""Self-intersections against shapes whose answer is known and a brute-force test of every pair."""

import itertools

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tryon_jax.mesh.intersections import self_intersecting_faces, self_intersections


def brute_force(vertices: np.ndarray, faces: np.ndarray) -> set[tuple[int, int]]:
    """Solve p + t d = a + u e + v f for every edge and every triangle without a corner in common."""
    found = set()
    for one, other in itertools.permutations(range(len(faces)), 2):
        a, b, c = vertices[faces[other]]
        for i, j in ((0, 1), (1, 2), (2, 0)):
            ends = faces[one][[i, j]]
            if len(set(faces[one].tolist()) & set(faces[other].tolist())) > 1 or set(ends) & set(faces[other]):
                continue
            p, q = vertices[ends]
            system = np.stack([q - p, a - b, a - c], axis=1)
            if abs(np.linalg.det(system)) < 1e-14:
                continue
            t, u, v = np.linalg.solve(system, a - p)
            if 0 < t < 1 and u > 0 and v > 0 and u + v < 1:
                found.add((min(one, other), max(one, other)))
    return found


@given(seed=st.integers(0, 10**6), count=st.integers(2, 14), size=st.floats(0.05, 2))
def test_agrees_with_brute_force(seed: int, count: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    centres = rng.uniform(size=(count, 1, 3))
    vertices = (centres + size * rng.normal(size=(count, 3, 3))).reshape(-1, 3)
    # Some faces share a corner or an edge, as in a mesh.
    faces = np.arange(3 * count).reshape(-1, 3)
    faces[1::2, 0] = faces[0::2, 0][: len(faces[1::2])]
    assert {tuple(pair) for pair in self_intersections(vertices, faces).tolist()} == brute_force(vertices, faces)


def test_a_sphere_does_not_cross_itself_and_two_do() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    assert not self_intersecting_faces(ball.vertices, ball.faces).any()
    shifted = np.concatenate([ball.vertices, ball.vertices + np.array([1.0, 0.003, 0.001])])
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    marked = self_intersecting_faces(shifted, faces)
    # The surfaces meet in the circle x = 0.5 of radius sqrt(3/4): only faces near it cross.
    centre = shifted[faces].mean(axis=1)
    off = np.hypot(centre[:, 0] - 0.5, np.hypot(centre[:, 1], centre[:, 2]) - np.sqrt(0.75))
    assert marked.any()
    assert off[marked].max() < 0.15
    assert marked[: len(ball.faces)].sum() == pytest.approx(marked[len(ball.faces) :].sum(), rel=0.2)


def test_a_fold_about_a_shared_corner_is_found() -> None:
    vertices = np.array([[0, 0, 0], [1, -0.5, 0], [1, 0.5, 0], [1.5, 0, -0.5], [1.5, 0, 0.5]], float)
    assert self_intersections(vertices, np.array([[0, 1, 2], [3, 4, 0]])).tolist() == [[0, 1]]
    vertices[3:, 0] = 0.5
    assert self_intersections(vertices, np.array([[0, 1, 2], [0, 3, 4]])).tolist() == [[0, 1]]
    vertices[3:, 2] += 2
    assert not self_intersecting_faces(vertices, np.array([[0, 1, 2], [0, 3, 4]])).any()


def test_mirrored_halves_that_meet_edge_on_edge_are_found() -> None:
    rng = np.random.default_rng(0)
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices = ball.vertices @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + np.array([0.9, 0, 0])
    both = np.concatenate([vertices, vertices * np.array([-1, 1, 1])])
    faces = np.concatenate([ball.faces, ball.faces[:, ::-1] + len(vertices)])
    x = both[faces][:, :, 0]
    across = (x.min(axis=1) < 0) & (x.max(axis=1) > 0)
    assert across.sum() > 20
    np.testing.assert_array_equal(self_intersecting_faces(both, faces), across)


def test_one_huge_face_among_small_ones() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    vertices = np.concatenate([ball.vertices, [[-50, -50, 1e-3], [50, -50, 1e-3], [0, 90, 1e-3]]])
    faces = np.concatenate([ball.faces, [[len(ball.vertices), len(ball.vertices) + 1, len(ball.vertices) + 2]]])
    z = ball.vertices[ball.faces][:, :, 2]
    expected = (z.min(axis=1) < 1e-3) & (z.max(axis=1) > 1e-3)
    np.testing.assert_array_equal(self_intersecting_faces(vertices, faces), [*expected, True])


def test_bad_meshes_are_refused() -> None:
    vertices = np.zeros((3, 3))
    assert self_intersecting_faces(vertices, np.zeros((0, 3), int)).shape == (0,)
    with pytest.raises(ValueError, match=r"index 3 vertices.*to 3"):
        self_intersecting_faces(vertices, np.array([[0, 1, 3]]))
    vertices[1] = np.nan
    with pytest.raises(ValueError, match="1 are not"):
        self_intersecting_faces(vertices, np.array([[0, 1, 2]]))
