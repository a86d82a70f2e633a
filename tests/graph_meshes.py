"""Meshes with known topology for the tests of graphs and networks."""

import numpy as np
from hypothesis import strategies as st
from scipy.spatial import Delaunay

Mesh = tuple[np.ndarray, np.ndarray]


def disc(count: int = 300, seed: int = 0) -> Mesh:
    """A wavy sheet of about 1 m² with one border."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (count, 2))
    faces = Delaunay(points).simplices
    a, b, c = (points[faces[:, k]] for k in range(3))
    cross = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces = np.where((cross < 0)[:, None], faces[:, ::-1], faces)
    height = 0.1 * np.sin(5.0 * points[:, 0]) * np.cos(4.0 * points[:, 1])
    return np.column_stack([points, height]), faces.astype(np.int64)


def tube(
    around: int = 16, along: int = 20, radius: float = 0.2, length: float = 0.6, seed: int = 0, shake: float = 0.003
) -> Mesh:
    """An open tube (two borders) around the y axis with slightly shaken vertices."""
    angle, row = np.meshgrid(np.arange(around), np.arange(along))
    theta = 2 * np.pi * (angle + 0.5 * (row % 2)) / around
    points = np.stack([radius * np.cos(theta), length * row / (along - 1) - length / 2, radius * np.sin(theta)], -1)
    points = points.reshape(-1, 3) + np.random.default_rng(seed).normal(0, shake, (around * along, 3))
    faces = []
    for j in range(along - 1):
        for i in range(around):
            a, b = j * around + i, j * around + (i + 1) % around
            c, d = a + around, b + around
            faces += [(a, c, b), (b, c, d)] if j % 2 == 0 else [(a, c, d), (a, d, b)]
    return points, np.array(faces)


def join(*meshes: Mesh) -> Mesh:
    """Several meshes as one with several components, each moved aside."""
    points, faces, count = [], [], 0
    for i, (v, f) in enumerate(meshes):
        points.append(v + np.array([1.5 * i, 0.0, 0.0]))
        faces.append(f + count)
        count += len(v)
    return np.concatenate(points), np.concatenate(faces)


def triangle() -> Mesh:
    """One triangle."""
    return np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]), np.array([[0, 1, 2]])


def fan(blades: int = 3) -> Mesh:
    """Triangles with a common vertex and nothing else in common: every outer vertex has two neighbours."""
    angle = np.linspace(0, 2 * np.pi, 2 * blades, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    return np.concatenate([np.zeros((1, 3)), 0.1 * rim]), np.array([[0, 2 * i + 1, 2 * i + 2] for i in range(blades)])


def meshes() -> st.SearchStrategy[Mesh]:
    """Random meshes with borders, several components, vertices of few neighbours, single triangles, lone vertices."""
    seeds = st.integers(0, 10_000)
    one = st.one_of(
        st.builds(disc, st.integers(4, 120), seeds),
        st.builds(tube, st.integers(3, 12), st.integers(2, 10), seed=seeds),
        st.just(triangle()),
        st.builds(fan, st.integers(1, 5)),
    )
    joined = st.lists(one, min_size=1, max_size=3).map(lambda parts: join(*parts))
    return st.tuples(joined, st.integers(0, 2)).map(
        lambda made: (np.concatenate([made[0][0], np.full((made[1], 3), 3.0)]), made[0][1])
    )
