"""Drapes kept clear of the body by a polynomial of its shape: against exact distances, and where nothing may move."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from tryon_jax.body import load_body, shape_body, vertex_normals
from tryon_jax.body.shape_polynomial import polynomial_terms
from tryon_jax.contact.clearance import KEPT_CLEAR, Clearance, keep_clear, measure_clearance
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.contact.skin import extremity_vertices
from tryon_jax.contact.skin_samples import SkinSamples, sample_skin
from tryon_jax.types import Body

AXES = (3.0, 2.0)
BETAS = np.array([[0.0, 0.0], [1.4, -1.1], [-2.0, 0.7], [0.3, 1.9]], np.float32)


@pytest.fixture(scope="module")
def body() -> Body:
    return load_body("female")


@pytest.fixture(scope="module")
def samples(body: Body) -> SkinSamples:
    return sample_skin(body, AXES)


@pytest.fixture(scope="module")
def chosen(body: Body) -> np.ndarray:
    """Vertices of trunk and limbs, without hands and feet."""
    return np.flatnonzero(~extremity_vertices(body))[::7].astype(np.int32)


def beside_skin(body: Body, chosen: np.ndarray, betas: np.ndarray, off: np.ndarray | float) -> np.ndarray:
    """Points at a distance from these vertices of the body along their normals, metres."""
    points = []
    for row in betas:
        shaped = shape_body(body, jnp.asarray(row))[0]
        normals = np.asarray(vertex_normals(shaped, body.faces))[chosen]
        points.append(np.asarray(shaped)[chosen] + np.reshape(off, (-1, 1)) * normals)
    return np.asarray(points, np.asarray(betas).dtype)


def clearance_of(body: Body, samples: SkinSamples, chosen: np.ndarray, off: np.ndarray | float) -> Clearance:
    drapes = jnp.asarray(beside_skin(body, chosen, np.asarray(samples.polynomials.betas), off))
    return measure_clearance(samples, drapes, chosen, np.ones(len(chosen), bool))


def distances(body: Body, vertices: np.ndarray, betas: np.ndarray) -> np.ndarray:
    skin = np.asarray(shape_body(body, jnp.asarray(betas))[0])
    return ClosedSurface(skin, np.asarray(body.faces)).closest(vertices).distance


def test_cloth_inside_any_body_of_the_range_comes_out(body: Body, samples: SkinSamples, chosen: np.ndarray) -> None:
    depth = np.random.default_rng(0).uniform(0.0, 0.006, len(chosen))
    inside = beside_skin(body, chosen, BETAS, -depth)
    terms = polynomial_terms(samples.polynomials, jnp.asarray(BETAS))
    found = np.asarray(keep_clear(clearance_of(body, samples, chosen, -depth), jnp.asarray(inside), terms))
    for k, betas in enumerate(BETAS):
        before, after = distances(body, inside[k], betas), distances(body, found[k], betas)
        assert (before < -1e-3).mean() > 0.7
        # Ears and folds of the skin, as in the armpits, have no one outward direction.
        assert (after < 0).mean() < 0.03
        assert abs(np.median(after) - KEPT_CLEAR) < 5e-4
    moved = np.linalg.norm(found - inside, axis=2)
    assert moved.max() < 0.012


def test_cloth_outside_stays_where_it_is(body: Body, samples: SkinSamples, chosen: np.ndarray) -> None:
    outside = beside_skin(body, chosen, BETAS, 0.008)
    clearance = clearance_of(body, samples, chosen, 0.008)
    terms = polynomial_terms(samples.polynomials, jnp.asarray(BETAS))
    found = np.asarray(keep_clear(clearance, jnp.asarray(outside), terms))
    assert (np.linalg.norm(found - outside, axis=2) == 0).mean() > 0.99


def test_the_distance_is_the_exact_one_at_the_sampled_bodies(
    body: Body, samples: SkinSamples, chosen: np.ndarray
) -> None:
    clearance = clearance_of(body, samples, chosen, 0.001)
    terms = np.asarray(polynomial_terms(samples.polynomials, jnp.asarray(samples.polynomials.betas)))
    found = terms @ np.asarray(clearance.distance).T
    exact = distances(
        body,
        beside_skin(body, chosen, np.asarray(samples.polynomials.betas), 0.001)[3],
        np.asarray(samples.polynomials.betas)[3],
    )
    assert np.median(np.abs(found[3] - exact)) < 5e-4


def test_padding_hands_and_feet_do_not_move(body: Body, samples: SkinSamples) -> None:
    hands = np.flatnonzero(extremity_vertices(body)).astype(np.int32)[::5]
    inside = jnp.asarray(beside_skin(body, hands, np.asarray(samples.polynomials.betas), -0.004))
    mask = np.ones(len(hands), bool)
    of_hands = measure_clearance(samples, inside, hands, mask)
    # The cloth over the wrist, where the nearest vertices are partly of the arm, may.
    terms = polynomial_terms(samples.polynomials, jnp.asarray(samples.polynomials.betas))
    moved = np.linalg.norm(np.asarray(keep_clear(of_hands, inside, terms) - inside), axis=2)
    assert (moved > 0).mean() < 0.1
    padded = measure_clearance(samples, inside, np.zeros(len(hands), np.int32), ~mask)
    assert not np.asarray(padded.outward).any()


def test_gradients_against_finite_differences(x64, body: Body, samples: SkinSamples, chosen: np.ndarray) -> None:
    def double(tree):
        return jax.tree.map(lambda a: np.asarray(a, np.float64) if np.asarray(a).dtype == np.float32 else a, tree)

    few = chosen[::40]
    drapes = jnp.asarray(beside_skin(double(body), few, np.asarray(samples.polynomials.betas, np.float64), -0.001))

    def moved(points, betas):
        clearance = measure_clearance(double(samples), jnp.asarray(points), few, np.ones(len(few), bool))
        terms = polynomial_terms(double(samples.polynomials), jnp.asarray(betas))
        return keep_clear(clearance, jnp.asarray(points[:1]), terms).sum()

    check_grads(moved, (drapes, jnp.array([[0.4, -0.3]])), order=1, modes=("rev",), rtol=1e-3)
