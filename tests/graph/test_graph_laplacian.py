"""Normalised Laplacian: definition, spectrum, null vector."""

import numpy as np
import pytest
from hypothesis import given

from tests.graph_meshes import disc, join, meshes, triangle, tube
from tryon_jax.graph.laplacian import largest_eigenvalue, normalised_laplacian, null_vector, scaled_laplacian
from tryon_jax.mesh.topology import components, unique_edges


@pytest.mark.parametrize("normalisation", ["random-walk", "symmetric"])
@given(mesh=meshes())
def test_spectrum_of_the_scaled_laplacian_lies_in_minus_one_to_one(normalisation, mesh):
    vertices, faces = mesh
    edges, _ = unique_edges(faces, len(vertices))
    scaled, bound = scaled_laplacian(edges, len(vertices), normalisation)
    values = np.sort(np.linalg.eigvals(scaled.toarray()).real)
    assert values[0] >= -1 - 1e-9
    assert values[-1] <= 1 + 1e-9
    # The bound is computed, not assumed: the spectrum fills the interval.
    assert values[-1] >= 1 - 4e-4
    assert bound <= 2.0


@given(meshes())
def test_null_space_has_one_dimension_per_component(mesh):
    vertices, faces = mesh
    edges, _ = unique_edges(faces, len(vertices))
    laplacian = normalised_laplacian(edges, len(vertices))
    np.testing.assert_allclose(laplacian @ null_vector(edges, len(vertices)), 0.0, atol=1e-12)
    zero = (np.linalg.eigvalsh(laplacian.toarray()) < 1e-9).sum()
    assert zero == components(faces, len(vertices))[0]


@given(mesh=meshes())
def test_constants_are_the_null_vector_of_the_random_walk(mesh):
    vertices, faces = mesh
    edges, _ = unique_edges(faces, len(vertices))
    scaled, _ = scaled_laplacian(edges, len(vertices))
    np.testing.assert_allclose(scaled @ np.ones(len(vertices)), -1.0, atol=1e-12)


def test_definition_on_a_triangle():
    laplacian = normalised_laplacian(np.array([[0, 1], [0, 2], [1, 2]]), 3).toarray()
    np.testing.assert_allclose(laplacian, 1.5 * np.eye(3) - 0.5)
    assert largest_eigenvalue(normalised_laplacian(np.array([[0, 1], [0, 2], [1, 2]]), 3)) == pytest.approx(1.5)


def test_largest_eigenvalue_by_lanczos_is_a_tight_upper_bound_and_repeatable():
    vertices, faces = join(disc(200), tube())
    laplacian = normalised_laplacian(unique_edges(faces, len(vertices))[0], len(vertices))
    exact = np.linalg.eigvalsh(laplacian.toarray())[-1]
    value = largest_eigenvalue(laplacian)
    assert exact <= value <= exact * (1 + 2e-4)
    assert value == largest_eigenvalue(laplacian)


def test_graph_without_edges_has_the_general_bound():
    scaled, bound = scaled_laplacian(np.zeros((0, 2), np.int64), 4)
    assert bound == 2.0
    np.testing.assert_array_equal(scaled.toarray(), -np.eye(4))


def test_isolated_node_keeps_an_empty_row():
    _, faces = triangle()
    laplacian = normalised_laplacian(unique_edges(faces, 5)[0], 5)
    assert laplacian.toarray()[3:].any() == np.False_
