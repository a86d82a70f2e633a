"""Kriged drapes: the kernel in its functions, the quadratic element, and fields of a design."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from benchmarks._machine import counting_compilations
from tryon_jax.nets.kernel_factor import with_factor, with_factors, without_factors
from tryon_jax.nets.kriging import (
    KernelFunctions,
    Kriging,
    KrigingConfig,
    apply_shape_functions,
    empty_kriging,
    functions_and_trend,
    joint_functions,
    kriged_fields,
    matern,
    quadratic_element,
)

# Two triangles, 0-1-2 and 1-2-3, of the unit square.
EDGES = np.array([[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]], np.int32)
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
NODES = np.concatenate([CORNERS, CORNERS[EDGES].mean(axis=1)])
CONFIG = KrigingConfig(designs=7, shapes=4, functions=12, components=5, nodes=len(NODES))


def random_kriging(seed: int = 0) -> Kriging:
    rng = np.random.default_rng(seed)
    empty = empty_kriging(CONFIG, 4, 3, 2)

    def filled(array: jax.Array) -> jax.Array:
        return jnp.asarray(rng.normal(size=array.shape), jnp.float32)

    arrays = {name: filled(getattr(empty, name)) for name in ("mean", "components", "weights")}
    first, second = np.indices((4, 3)).reshape(2, -1)
    made = replace(
        empty,
        edges=jnp.asarray(EDGES),
        design_scale=jnp.array([0.1, 0.2, 0.3]),
        designs=replace(empty.designs, centres=jnp.asarray(rng.uniform(-1, 1, (7, 3)), jnp.float32)),
        of_design=jnp.asarray([*rng.integers(7, size=12), *(7 + first)]),
        of_shape=jnp.asarray([*rng.integers(4, size=12), *(4 + second)]),
        shapes=replace(
            empty.shapes,
            shape_scale=jnp.array([3.0, 2.0]),
            kernel=replace(empty.shapes.kernel, centres=jnp.asarray(rng.uniform(-1, 1, (4, 2)), jnp.float32)),
        ),
        **arrays,
    )
    return with_factors(made)


def test_products_of_the_functions_add_up_to_the_kernel_at_the_centres() -> None:
    rng = np.random.default_rng(1)
    centres, others = rng.uniform(-1, 1, (2, 40, 2))
    functions = with_factor(KernelFunctions(jnp.asarray(centres, jnp.float32), None, 0.8))

    def products(points: np.ndarray) -> np.ndarray:
        values = np.asarray(functions_and_trend(functions, jnp.asarray(points, jnp.float32)))
        return values[:, :40] @ values[:, :40].T

    np.testing.assert_allclose(products(centres), matern(centres, centres, 0.8, np), atol=1e-4)
    # Elsewhere they know no more than the centres tell.
    left = 1.0 - np.diag(products(others))
    assert left.min() > -1e-4
    assert 0.001 < left.mean() < 0.1


def test_each_function_is_new_at_its_centre() -> None:
    centres = np.random.default_rng(2).uniform(-1, 1, (9, 3))
    functions = with_factor(KernelFunctions(jnp.asarray(centres, jnp.float32), None, 1.0))
    values = np.asarray(functions_and_trend(functions, jnp.asarray(centres, jnp.float32)))[:, :9]
    np.testing.assert_allclose(np.triu(values, 1), 0.0, atol=1e-5)
    np.testing.assert_allclose(np.diag(values), 1.0 / np.diag(np.asarray(functions.factor)), rtol=1e-4)


def test_the_kernel_at_known_distances() -> None:
    # 1 + √3 r over e^(√3 r) at r = 1/2 and 2, worked out by hand.
    at = np.array([[0.0], [0.5], [2.0]])
    found = matern(at, at[:1], 1.0, np)[:, 0]
    np.testing.assert_allclose(found, [1.0, 0.784888, 0.139731], atol=1e-6)


def test_joint_functions_are_products() -> None:
    rng = np.random.default_rng(2)
    one, other = rng.normal(size=(6, 5)), rng.normal(size=(6, 3))
    found = joint_functions(jnp.asarray(one), jnp.asarray(other), (np.array([0, 4, 4]), np.array([2, 0, 1])))
    np.testing.assert_allclose(
        found, np.stack([one[:, 0] * other[:, 2], one[:, 4] * other[:, 0], one[:, 4] * other[:, 1]], 1), rtol=1e-6
    )


def test_files_do_not_keep_the_factors() -> None:
    kriging = random_kriging()
    bare = without_factors(kriging)
    assert bare.designs.factor is None
    assert bare.shapes.kernel.factor is None
    again = with_factors(bare)
    for one, other in zip(jax.tree.leaves(kriging), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(AssertionError, match="as a file keeps them"):
        apply_shape_functions(bare.shapes, jnp.zeros((1, 2)))


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
    of_designs = functions_and_trend(kriging.designs, scaled)
    of_shapes = functions_and_trend(kriging.shapes.kernel, betas / jnp.array([[3.0, 2.0]]))
    values = joint_functions(of_designs, of_shapes, (kriging.of_design, kriging.of_shape))
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
