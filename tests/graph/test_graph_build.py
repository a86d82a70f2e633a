"""Graphs of garments: what is in them, what padding does, what is refused."""

import dataclasses

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.distance import cdist

from tests.graph_meshes import fan, meshes, triangle, tube
from tryon_jax.body import load_body
from tryon_jax.graph import GarmentGraph, build_graph, stack_graphs
from tryon_jax.graph.build import blend_skinning


@pytest.fixture(scope="module")
def body():
    return load_body()


def test_levels_halve_and_carry_their_operators(body):
    vertices, faces = tube(24, 40)
    graph = build_graph(vertices, faces, body)
    assert graph.num_nodes == 960
    assert [int(np.sum(level.mask)) for level in graph.levels] == [960, 480, 240, 120, 60]
    for level, coarser in zip(graph.levels, graph.levels[1:], strict=False):
        assert level.down.shape == level.up.shape[::-1] == (len(coarser.mask), len(level.mask))
    assert graph.levels[-1].down is None
    np.testing.assert_array_equal(graph.faces[: len(faces)], faces)
    assert not graph.faces[len(faces) :].any()


def test_skinning_weights_are_those_of_the_body_nearby(body):
    vertices, faces = tube()
    graph = build_graph(vertices, faces, body)
    found = graph.skinning_weights[: len(vertices)]
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-6)
    near = np.argsort(cdist(vertices, np.asarray(body.v_template)), axis=1)[:, :8]
    weights = np.asarray(body.lbs_weights)[near]
    assert (found >= weights.min(axis=1) - 1e-6).all()
    assert (found <= weights.max(axis=1) + 1e-6).all()


def test_skinning_weights_at_a_body_vertex_are_its_own_and_change_without_jumps(body):
    template = np.asarray(body.v_template, np.float64)
    np.testing.assert_allclose(blend_skinning(template[:1], body), np.asarray(body.lbs_weights)[:1], atol=0.5)
    line = template[:1] + np.linspace(0.0, 0.3, 3001)[:, None] * np.array([[0.2, 1.0, 0.4]])
    steps = np.abs(np.diff(blend_skinning(line, body), axis=0)).max()
    assert steps < 0.05


@settings(max_examples=5)
@given(meshes())
def test_any_mesh_becomes_a_graph(body, mesh):
    vertices, faces = mesh
    graph = build_graph(vertices, faces, body)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(graph))
    for level in graph.levels:
        dense = level.laplacian.to_bcoo().todense()
        count = int(np.sum(level.mask))
        assert not np.asarray(dense)[count:].any()
        np.testing.assert_array_equal(np.asarray(dense) != 0, np.asarray(dense).T != 0)


def test_garments_of_one_bucket_have_one_structure_and_stack(body):
    graphs = [build_graph(*tube(20, 28, seed=s), body) for s in range(2)] + [build_graph(*tube(19, 30), body)]
    shapes = [jax.tree.map(np.shape, jax.tree.leaves(g)) for g in graphs]
    assert shapes[0] == shapes[1] == shapes[2]
    stacked = stack_graphs(graphs)
    assert isinstance(stacked, GarmentGraph)
    assert stacked.num_nodes == 576
    np.testing.assert_array_equal(stacked.num_vertices, [560, 560, 570])


def test_tiny_meshes(body):
    for mesh in (triangle(), fan(2)):
        assert build_graph(*mesh, body).num_nodes == 512


def test_more_neighbours_than_planned_grow_the_lists(body):
    vertices, faces = fan(40)
    rim = np.arange(1, 81)
    faces = np.stack([np.zeros(80, int), rim, np.roll(rim, -1)], axis=1)
    graph = build_graph(vertices, faces, body)
    dense = np.asarray(graph.levels[0].laplacian.to_bcoo().todense())
    assert (dense[0] != 0).sum() >= 80


def test_levels_are_taken_over(body):
    """With them the graph is that of the same faces, whatever the vertices."""
    vertices, faces = tube()
    first = build_graph(vertices, faces, body)
    again = build_graph(1.1 * vertices, faces, body, levels=first.levels)
    assert again.levels is first.levels
    np.testing.assert_allclose(again.vertices, 1.1 * np.asarray(first.vertices), rtol=1e-6)
    with pytest.raises(ValueError, match="levels are of 320 vertices, the mesh has 3"):
        build_graph(*triangle(), body, levels=first.levels)


def test_faults_are_named(body):
    vertices, faces = tube()
    with pytest.raises(ValueError, match="0 vertices"):
        build_graph(np.zeros((0, 3)), np.zeros((0, 3), int), body)
    with pytest.raises(ValueError, match="vertex 320"):
        build_graph(vertices, faces + 1, body)
    with pytest.raises(ValueError, match="does not hold"):
        build_graph(vertices, faces, body, bucket=256)
    with pytest.raises(ValueError, match="different buckets"):
        stack_graphs([build_graph(vertices, faces, body), build_graph(vertices, faces, body, bucket=576)])


def test_dtype_is_that_asked_for(body):
    graph = build_graph(*triangle(), body, dtype=np.float64)
    floats = [np.asarray(leaf).dtype for leaf in jax.tree.leaves(graph) if np.asarray(leaf).dtype.kind == "f"]
    assert set(floats) == {np.dtype(np.float64)}
    assert dataclasses.is_dataclass(graph)
