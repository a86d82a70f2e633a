"""Kriged drapes: the kernel in its eigenfunctions, the quadratic element, and fields of a design."""

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.distance import cdist

from benchmarks._machine import counting_compilations
from tryon_jax.nets.kriging import (
    Kriging,
    KrigingConfig,
    ShapeFunctions,
    apply_shape_functions,
    eigenfunctions,
    empty_kriging,
    exponents,
    function_pairs,
    joint_functions,
    kriged_fields,
    quadratic_element,
)

# Two triangles, 0-1-2 and 1-2-3, of the unit square.
EDGES = np.array([[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]], np.int32)
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
NODES = np.concatenate([CORNERS, CORNERS[EDGES].mean(axis=1)])
CONFIG = KrigingConfig(degree=4, shape_degree=3, components=5, nodes=len(NODES))


def random_kriging(seed: int = 0) -> Kriging:
    rng = np.random.default_rng(seed)
    empty = empty_kriging(CONFIG, 4, 3, 2)

    def filled(array: jax.Array) -> jax.Array:
        return jnp.asarray(rng.normal(size=array.shape), jnp.float32)

    arrays = {name: filled(getattr(empty, name)) for name in ("mean", "components", "weights")}
    shapes = ShapeFunctions(jnp.array([3.0, 2.0]), CONFIG)
    return replace(empty, edges=jnp.asarray(EDGES), design_scale=jnp.array([0.1, 0.2, 0.3]), shapes=shapes, **arrays)


def test_products_of_the_eigenfunctions_add_up_to_the_kernel() -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (40, 2))
    errors = []
    for degree in (4, 8, 16):
        values = np.asarray(eigenfunctions(jnp.asarray(points), 0.7, 0.6, exponents(2, degree)))
        exact = np.exp(-0.5 * cdist(points / 0.7, points / 0.7, "sqeuclidean"))
        errors.append(np.abs(values @ values.T - exact).max())
    assert errors[-1] < 2e-4
    assert all(later < 0.5 * earlier for earlier, later in pairwise(errors))


def test_joint_functions_are_products_up_to_a_degree_and_a_trend() -> None:
    rng = np.random.default_rng(2)
    designs, shapes = jnp.asarray(rng.uniform(-1, 1, (6, 3))), jnp.asarray(rng.uniform(-1, 1, (6, 2)))
    found = np.asarray(joint_functions(designs, shapes, CONFIG))
    first, second = function_pairs(CONFIG, 3, 2)
    assert found.shape == (6, len(first))
    degrees = exponents(3, CONFIG.degree), exponents(2, CONFIG.shape_degree)
    one = np.asarray(eigenfunctions(designs, CONFIG.design, CONFIG.spread, degrees[0]))
    other = np.asarray(eigenfunctions(shapes, CONFIG.shape, CONFIG.spread, degrees[1]))
    kernel = len(first) - 12
    assert (degrees[0][first[:kernel]].sum(axis=1) + degrees[1][second[:kernel]].sum(axis=1)).max() == CONFIG.degree
    # Each is one of the products, and none is there twice.
    assert len(set(zip(first.tolist(), second.tolist(), strict=True))) == len(first)
    np.testing.assert_allclose(found[:, :kernel], one[:, first[:kernel]] * other[:, second[:kernel]], rtol=1e-6)
    linear = [np.concatenate([np.ones((6, 1)), points], axis=1) for points in (designs, shapes)]
    np.testing.assert_allclose(
        found[:, kernel:], (linear[0][:, :, None] * linear[1][:, None]).reshape(6, 12), rtol=1e-6
    )


def test_the_quadratic_element_is_exact_for_quadratic_functions() -> None:
    rng = np.random.default_rng(3)
    corners = np.array([[0, 1, 2], [3, 2, 1]])[rng.integers(2, size=50)]
    weights = rng.dirichlet(np.ones(3), 50)
    # As outline samples are given: two ends of an edge, the first one twice.
    corners = np.concatenate([corners, [[1, 3, 1], [2, 2, 2]]])
    weights = np.concatenate([weights, [[0.3, 0.7, 0.0], [1.0, 0.0, 0.0]]])
    points = np.einsum("nk,nkc->nc", weights, CORNERS[corners])

    def function(at: np.ndarray) -> np.ndarray:
        x, y = at.T
        return 1.0 - 2.0 * x + 3.0 * y + 0.5 * x * x - 1.5 * x * y + 2.5 * y * y

    nodes, shares = quadratic_element(EDGES, 4, jnp.asarray(corners), jnp.asarray(weights, jnp.float32))
    np.testing.assert_allclose((function(NODES)[nodes] * shares).sum(axis=1), function(points), atol=2e-6)
    np.testing.assert_allclose(np.asarray(shares).sum(axis=1), 1.0, atol=1e-6)


def test_padding_gets_nothing() -> None:
    _, shares = quadratic_element(EDGES, 4, jnp.zeros((3, 3), jnp.int32), jnp.zeros((3, 3)))
    assert not np.asarray(shares).any()


def test_the_fields_weighted_by_the_shape_functions_are_the_process() -> None:
    kriging = random_kriging()
    design, betas = jnp.array([0.05, -0.1, 0.2]), jnp.array([[1.0, -1.0], [0.0, 0.0], [-3.0, 0.5]])
    corners, weights = jnp.array([[0, 1, 2], [3, 2, 1]]), jnp.array([[0.2, 0.3, 0.5], [0.6, 0.1, 0.3]])
    fields = kriged_fields(kriging, design, corners, weights)
    found = np.einsum("nck,bk->bnc", fields, apply_shape_functions(kriging.shapes, betas))
    scaled = jnp.broadcast_to((design / kriging.design_scale)[None], (3, 3))
    values = joint_functions(scaled, betas / jnp.array([[3.0, 2.0]]), CONFIG)
    at_nodes = np.einsum("bf,fr,rqc->bqc", values, kriging.weights, kriging.components) + np.asarray(kriging.mean)
    nodes, shares = quadratic_element(EDGES, 4, corners, weights)
    np.testing.assert_allclose(found, np.einsum("vn,bvnc->bvc", shares, at_nodes[:, nodes]), rtol=1e-4, atol=1e-4)


def test_far_from_all_shapes_only_the_trend_is_left() -> None:
    values = np.asarray(apply_shape_functions(random_kriging().shapes, jnp.array([[30.0, 20.0]])))
    np.testing.assert_allclose(values[0, -3:], [1.0, 10.0, 10.0], rtol=1e-6)
    np.testing.assert_allclose(values[0, :-3], 0.0, atol=1e-6)


def test_it_is_differentiable_in_design_and_betas() -> None:
    kriging = random_kriging()
    corners, weights = jnp.array([[0, 1, 2]]), jnp.array([[0.2, 0.3, 0.5]])

    def drape(design: jax.Array, betas: jax.Array) -> jax.Array:
        fields = kriged_fields(kriging, jnp.asarray(design), corners, weights)
        return fields @ apply_shape_functions(kriging.shapes, jnp.asarray(betas)[None])[0]

    check_grads(drape, (jnp.array([0.02, 0.05, -0.1]), jnp.array([0.7, -0.4])), order=1, eps=1e-3, rtol=2e-2)


def test_nothing_is_compiled_for_another_design() -> None:
    kriging, corners, weights = random_kriging(), jnp.array([[0, 1, 2]]), jnp.array([[0.2, 0.3, 0.5]])
    fields = jax.jit(kriged_fields)
    first, second = jnp.array([0.0, 0.0, 0.0]), jnp.array([0.1, 0.2, 0.3])
    fields(kriging, first, corners, weights)
    with counting_compilations() as compilations:
        fields(kriging, second, corners, weights)
    assert compilations.count == 0


@pytest.mark.parametrize(("dimensions", "degree", "count"), [(1, 4, 5), (2, 6, 28), (3, 8, 165)])
def test_there_are_as_many_functions_as_monomials(dimensions: int, degree: int, count: int) -> None:
    found = exponents(dimensions, degree)
    assert found.shape == (count, dimensions)
    assert len(set(map(tuple, found.tolist()))) == count
