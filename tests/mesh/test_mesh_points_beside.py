"""Points that are called clear of a mesh are far from it, and on the same side as their owner."""

import numpy as np
import pytest
import trimesh

from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.mesh.closest_points import MeshSearch
from tryon_jax.mesh.points_beside import PointsBeside


def beside(search, owners, offsets, limit, farthest=np.inf, across=None):
    owner = np.repeat(np.arange(len(owners)), offsets.shape[1])
    points = (owners[:, None] + offsets).reshape(-1, 3)
    across = np.zeros_like(owners) if across is None else across
    found = PointsBeside(points, owner, owners, across, limit, farthest)
    search.closest(owners, 0.0, found)
    return points, owner, found.clear


@pytest.mark.parametrize("seed", range(6))
def test_what_is_clear_is_far_and_on_the_same_side(seed):
    random = np.random.default_rng(seed)
    mesh = trimesh.creation.icosphere(subdivisions=seed % 3 + 1, radius=0.1)
    vertices = mesh.vertices * [1.0, 0.2, 0.7]
    search = MeshSearch(vertices, mesh.faces)
    owners = random.normal(size=(200, 3)) * [0.1, 0.03, 0.08]
    offsets = random.normal(size=(200, 4, 3)) * random.choice([0.003, 0.02, 0.1], size=(200, 1, 1))
    across = random.normal(size=(200, 3))
    across /= np.linalg.norm(across, axis=1)[:, None]
    # Some lie in a plane, as those of a cloth do.
    offsets[::2] -= np.einsum("pkc,pc->pk", offsets[::2], across[::2])[..., None] * across[::2, None]
    points, owner, clear = beside(search, owners, offsets, 0.004, across=across)
    assert 0.2 < clear.mean() < 0.98
    assert search.closest(points[clear]).distance.min() > 0.004
    solid = ClosedSurface(vertices, mesh.faces)
    inside, owner_inside = (solid.closest(at).distance < 0 for at in (points[clear], owners[owner[clear]]))
    np.testing.assert_array_equal(inside, owner_inside)


def test_the_other_side_of_a_sheet_is_not_clear():
    sheet = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    search = MeshSearch(sheet, np.array([[0, 1, 2], [0, 2, 3]]))
    owners = np.array([[0.1, 0.2, 0.05]])
    offsets = np.array([[[0, 0, 0.1], [0, 0, -0.02], [0, 0, -0.1], [0.5, 0, 0]]])
    _, _, clear = beside(search, owners, offsets, 0.01)
    np.testing.assert_array_equal(clear, [True, True, False, True])


def test_what_is_far_from_its_owner_is_not_clear():
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    search = MeshSearch(mesh.vertices, mesh.faces)
    _, _, clear = beside(search, np.array([[0.3, 0, 0]]), np.array([[[0.01, 0, 0], [0.2, 0, 0]]]), 0.01, 0.1)
    np.testing.assert_array_equal(clear, [True, False])
