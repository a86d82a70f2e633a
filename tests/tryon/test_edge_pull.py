"""Stretched edges pulled together on the bodies they are measured on, and between them by polynomials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.body.shape_polynomial import ShapePolynomials, polynomial_terms, shape_polynomials
from tryon_jax.mesh.stretch_limit import limit_stretch
from tryon_jax.tryon.edge_pull import _ROUNDS, MOST, apply_pull, fit_pull, pull_together

COUNT = 81
EDGES = np.stack([np.arange(COUNT - 1), np.arange(1, COUNT)], axis=1).astype(np.int32)
REST = np.full(COUNT - 1, 0.01, np.float32)


@pytest.fixture(scope="module")
def polynomials() -> ShapePolynomials:
    return shape_polynomials((3.0, 2.0))


def ropes(stretch: np.ndarray) -> np.ndarray:
    """Straight ropes [S, N, 3], metres, whose edge in the middle is so many times as long as the others."""
    lengths = np.tile(REST, (len(stretch), 1))
    lengths[:, 40] *= stretch
    along = np.concatenate([np.zeros((len(stretch), 1)), np.cumsum(lengths, axis=1)], axis=1)
    return np.stack([along, 0 * along, 0 * along], axis=2).astype(np.float32)


def stretch_of(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(points, axis=1), axis=2) / REST


def test_it_does_what_the_host_does() -> None:
    points = ropes(np.array([1.0, 1.5, 1.9]))
    moves = np.asarray(jax.jit(pull_together)(jnp.asarray(points), EDGES, REST))
    assert not moves[0].any()
    for rope, moved in zip(points[1:], points[1:] + moves[1:], strict=True):
        expected = limit_stretch(rope, EDGES, REST, MOST, _ROUNDS)
        np.testing.assert_allclose(moved, expected, atol=2e-5)
    assert stretch_of(points + moves).max() < 1.01 * MOST
    # A rope that is stretched as a whole cannot be pulled together; nothing else happens to it.
    taut = 1.5 * ropes(np.array([1.0]))
    assert np.abs(np.asarray(pull_together(jnp.asarray(taut), EDGES, REST))).max() < 0.1


def test_between_the_bodies_edges_are_as_short(polynomials: ShapePolynomials) -> None:
    def stretch(betas: np.ndarray) -> np.ndarray:
        return 1.2 + 0.2 * betas[:, 0] / 3 + 0.25 * (betas[:, 1] / 2) ** 2

    known = ropes(stretch(np.asarray(polynomials.betas)))
    moves = pull_together(jnp.asarray(known), EDGES, REST)
    pull = fit_pull(polynomials, jnp.moveaxis(moves, 0, -1))
    assert len(pull.vertices) == COUNT
    betas = np.array([[2.0, 0.9], [1.0, -1.5], [-1.5, 0.2]], np.float32)
    points = ropes(stretch(betas))
    found = apply_pull(pull, jnp.asarray(points), polynomial_terms(polynomials, jnp.asarray(betas)))
    assert stretch_of(points)[:2].max() > 1.35
    assert stretch_of(np.asarray(found)).max() < MOST + 0.05


def test_derivatives_pass_through(polynomials: ShapePolynomials) -> None:
    points = jnp.asarray(ropes(np.full(19, 1.6)))

    def total(drapes: jax.Array) -> jax.Array:
        return (drapes + pull_together(drapes, EDGES, REST)).sum()

    np.testing.assert_allclose(jax.grad(total)(points), np.ones(points.shape), atol=1e-6)
