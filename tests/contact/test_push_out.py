"""Push-out: nothing left inside, nothing moved that need not, least displacement."""

import numpy as np
import pytest
import trimesh

from tests.graph_meshes import tube
from tryon_jax.contact.push_out import EXACT_BELOW, _least_move, _multipliers, _Samples, push_out, sample_matrix
from tryon_jax.contact.signed_distance import ClosedSurface


@pytest.fixture(scope="module")
def ball():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    return ClosedSurface(mesh.vertices, mesh.faces)


def test_tube_around_a_ball_comes_out_everywhere(ball):
    vertices, faces = tube(30, 24, radius=0.19)
    result = push_out(vertices, faces, ball)
    assert result.inside_before > 0.05
    assert result.deepest_before > 0.005
    assert result.is_outside
    assert result.deepest == 0.0
    # Measured here again, on every sample.
    distance = ball.closest(sample_matrix(faces, len(vertices)) @ result.vertices).distance
    assert distance.min() >= 0.0015
    # No vertex went much farther than the deepest sample and its clearance asked for.
    assert result.largest_move < 2.5 * (result.deepest_before + 0.002)


def test_cloth_that_keeps_its_distance_is_not_touched(ball):
    vertices, faces = tube(20, 16, radius=0.25)
    result = push_out(vertices, faces, ball)
    np.testing.assert_array_equal(result.vertices, vertices)
    assert result.rounds == 0
    assert result.inside == result.inside_before == 0.0


def test_only_the_neighbourhood_of_a_penetration_moves(ball):
    vertices, faces = tube(30, 24, radius=0.26)
    dented = int(np.argmin(np.abs(vertices[:, 1]) + np.abs(vertices[:, 0])))
    vertices[dented] *= 0.19 / np.linalg.norm(vertices[dented])
    result = push_out(vertices, faces, ball)
    assert result.is_outside
    moved = np.flatnonzero(np.abs(result.vertices - vertices).max(axis=1) > 1e-9)
    ring = np.unique(faces[(faces == dented).any(axis=1)])
    assert set(moved) <= set(ring)
    # One vertex 1 cm inside: the least move is straight out along its radius.
    step = result.vertices[dented] - vertices[dented]
    assert np.linalg.norm(step) == pytest.approx(0.0121, abs=0.001)


def test_what_it_tells_is_what_a_full_measurement_finds(ball):
    """Also where samples that had not moved were not measured again, and where rounds run out."""
    vertices, faces = tube(30, 24, radius=0.2)
    vertices[:, 0] += 0.01
    for rounds in (0, 1, 40):
        result = push_out(vertices, faces, ball, max_rounds=rounds)
        distance = ball.closest(sample_matrix(faces, len(vertices)) @ result.vertices).distance
        assert result.inside == (distance < 0).mean()
        assert result.deepest == pytest.approx(max(0.0, -distance.min()), abs=1e-12)
        assert result.rounds <= rounds
    assert result.is_outside


@pytest.mark.parametrize("precision", [np.float32, np.float64])
@pytest.mark.parametrize("radius", [0.19, 0.22, 0.25])
def test_distances_are_those_of_the_very_vertices(ball, precision, radius):
    """In the precision that they are handed out in, whether they moved or not."""
    vertices, faces = tube(30, 24, radius=radius)
    result = push_out(vertices.astype(precision), faces, ball)
    assert result.vertices.dtype == precision
    expected = ball.closest(result.vertices.astype(np.float64)).distance
    near = expected < EXACT_BELOW
    np.testing.assert_allclose(result.distance[near], expected[near], rtol=0, atol=1e-12)
    assert (result.distance >= np.minimum(expected, EXACT_BELOW) - 1e-12).all()


@pytest.mark.parametrize("depth", [0.001, 0.02])
def test_looking_only_around_what_is_missing_changes_nothing(ball, depth):
    """A little missing, and so much that the push spreads over several rings."""
    vertices, faces = tube(30, 24, radius=0.2)
    samples = sample_matrix(faces, len(vertices))
    at = samples @ vertices
    away = at * [1, 1, 0] / np.linalg.norm(at[:, :2], axis=1)[:, None]
    dent = np.linalg.norm(at - vertices[300], axis=1)
    missing = depth * np.exp(-((dent / 0.02) ** 2)) - 0.0005
    multiplier, pushed = _multipliers(samples, away, missing)
    assert 0 < pushed.sum() < 0.5 * len(pushed)
    expected = samples.T @ (multiplier[:, None] * away)
    known = _Samples(samples, ball, vertices, faces, 0.0)
    known.distance, known.away = -missing, away
    np.testing.assert_allclose(_least_move(samples, known, 0.0), expected, atol=1e-15)


def test_flat_body_gives_the_exact_least_displacement():
    box = trimesh.creation.box(extents=(2.0, 0.2, 2.0))
    body = ClosedSurface(box.vertices, box.faces)
    vertices = np.array([[0.0, 0.11, 0.0], [0.1, 0.09, 0.0], [0.0, 0.12, 0.1]])
    result = push_out(vertices, np.array([[0, 1, 2]]), body, clearance=0.002)
    expected = vertices.copy()
    expected[1, 1] = 0.1021
    np.testing.assert_allclose(result.vertices, expected, atol=5e-5)


def test_bad_input(ball):
    vertices, faces = tube(6, 4)
    with pytest.raises(ValueError, match=r"clearance = 0\.2 m"):
        push_out(vertices, faces, ball, clearance=0.2)
    with pytest.raises(ValueError, match="vertices must be finite"):
        push_out(vertices * np.nan, faces, ball)
