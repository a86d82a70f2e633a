"""Quadric coarsening: exact count, unchanged topology, borders that stay, sound triangles."""

import numpy as np
from hypothesis import given

from tests.graph_meshes import disc, fan, join, meshes, triangle, tube
from tryon_jax.graph.coarsen import MAX_VALENCE, coarsen
from tryon_jax.mesh.topology import border_mask, inspect_topology, unique_edges


def smallest_angle(vertices, faces):
    corners = vertices[faces]
    angles = []
    for k in range(3):
        a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        cosine = (a * b).sum(1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
        angles.append(np.arccos(np.clip(cosine, -1, 1)))
    return np.degrees(np.min(angles))


def test_halving_is_exact_and_keeps_topology_over_four_levels():
    vertices, faces = join(tube(20, 30), tube(30, 16, seed=1))
    topology = inspect_topology(faces, len(vertices))
    for _ in range(4):
        coarse = coarsen(vertices, faces)
        assert len(coarse.kept) == (len(vertices) + 1) // 2
        assert border_mask(coarse.faces, len(coarse.kept)).sum() > 0
        vertices, faces = vertices[coarse.kept], coarse.faces
        now = inspect_topology(faces, len(vertices))
        assert now.is_manifold
        assert (now.euler, now.loops, now.components) == (topology.euler, topology.loops, topology.components)
        edges, _ = unique_edges(faces, len(vertices))
        assert np.bincount(edges.ravel()).max() <= MAX_VALENCE
        assert smallest_angle(vertices, faces) > 5.0


def test_border_shrinks_only_along_itself():
    vertices, faces = tube(24, 24)
    coarse = coarsen(vertices, faces)
    fine_border, coarse_border = border_mask(faces, len(vertices)), border_mask(coarse.faces, len(coarse.kept))
    # Coarse border vertices are fine border vertices, and fine border vertices collapse into them only.
    assert fine_border[coarse.kept[coarse_border]].all()
    assert coarse_border[coarse.cluster[fine_border]].all()


def test_flat_grid_coarsens_without_leaving_its_plane_or_outline():
    x, y = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], -1)
    i = np.arange(20)[:, None] * 21 + np.arange(20)[None, :]
    i = i.ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + 21], 1), np.stack([i + 1, i + 22, i + 21], 1)])
    coarse = coarsen(vertices, faces)
    corners = vertices[coarse.kept][coarse.faces]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert (area > 0).all()
    # The four corners cost most, so the outline and with it the area stay exactly.
    np.testing.assert_allclose(area.sum(), 1.0, rtol=1e-12)


@given(meshes())
def test_any_mesh_gives_a_consistent_map(mesh):
    vertices, faces = mesh
    coarse = coarsen(vertices, faces)
    before, after = inspect_topology(faces, len(vertices)), inspect_topology(coarse.faces, len(coarse.kept))
    assert (len(vertices) + 1) // 2 <= len(coarse.kept) <= len(vertices)
    np.testing.assert_array_equal(coarse.cluster[coarse.kept], np.arange(len(coarse.kept)))
    assert after.unused_vertices == before.unused_vertices
    assert after.components == before.components
    assert after.euler == before.euler
    assert after.non_manifold_edges <= before.non_manifold_edges
    assert after.consistently_oriented


def test_meshes_that_cannot_be_coarser_stay():
    for vertices, faces in (triangle(), fan(3)):
        coarse = coarsen(vertices, faces)
        np.testing.assert_array_equal(coarse.faces, faces)
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert len(coarsen(vertices, tetrahedron).kept) == 4


def test_scale_and_place_do_not_matter():
    vertices, faces = disc(200)
    first, second = coarsen(vertices, faces), coarsen(1000 * vertices + 128.0, faces)
    np.testing.assert_array_equal(first.kept, second.kept)
    np.testing.assert_array_equal(first.faces, second.faces)
