"""The collision body: closed, outward, around hands and feet, for any shape."""

import numpy as np
import pytest

from tryon_jax.body import load_body
from tryon_jax.contact.closest_points import closest_points
from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.mesh.topology import inspect_topology
from tryon_jax.physics.dressing import Obstacle

SHAPES = ((0.0, 0.0), (3.0, 0.0), (-3.0, 0.0), (0.0, 2.0), (0.0, -2.0), (2.1, -1.4))


@pytest.fixture(scope="module")
def obstacle() -> Obstacle:
    return Obstacle(load_body("female"))


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def test_it_is_one_closed_outward_surface(obstacle: Obstacle) -> None:
    faces = obstacle.collision.faces
    report = inspect_topology(faces, int(faces.max()) + 1)
    assert report.is_manifold
    assert (report.loops, report.components, report.euler) == (0, 1, 2)
    for betas in SHAPES:
        surface = obstacle.surface(np.array(betas))
        vertices = np.asarray(surface.vertices, float)
        skin = obstacle.skin(np.array(betas))
        volume = signed_volume(vertices, faces)
        # Mittens add a little to the body, and nothing is lost.
        assert volume == pytest.approx(signed_volume(skin.astype(float), np.asarray(obstacle.body.faces)), rel=0.06)
        normals = np.asarray(surface.normals)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
        corners = vertices[faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        assert area.min() > 1e-9
        # A step outwards along the normals grows the body.
        assert signed_volume(vertices + 1e-4 * normals, faces) > volume


def test_it_keeps_the_skin_where_cloth_rests(obstacle: Obstacle) -> None:
    body = obstacle.body
    arms_and_trunk = np.asarray(obstacle.collision.keep)
    feet = np.concatenate(obstacle.collision.feet)
    plain = ~np.isin(arms_and_trunk, feet)
    for betas in SHAPES[:3]:
        surface = np.asarray(obstacle.surface(np.array(betas)).vertices)
        np.testing.assert_allclose(
            surface[: len(arms_and_trunk)][plain], obstacle.skin(np.array(betas))[arms_and_trunk[plain]], atol=1e-6
        )
    kept = len(arms_and_trunk) / len(np.asarray(body.v_template))
    assert kept > 0.5


def test_mittens_cover_the_hands(obstacle: Obstacle) -> None:
    """Fingers and palm; the tips of the thumbs stay outside, by two centimetres and a bit."""
    for betas in (SHAPES[0], SHAPES[1], SHAPES[4]):
        surface, skin = obstacle.surface(np.array(betas)), obstacle.skin(np.array(betas))
        for mitten in obstacle.collision.mittens:
            distance = np.asarray(closest_points(surface, skin[mitten.hand]).height)
            assert (distance < 0).mean() > 0.8
            assert np.percentile(distance, 95) < 0.008
            assert distance.max() < 0.025


def test_smoothed_feet_have_no_toes(obstacle: Obstacle) -> None:
    """Less detail, about the same size."""
    betas = np.zeros(2)
    surface, skin = np.asarray(obstacle.surface(betas).vertices), obstacle.skin(betas)
    keep = obstacle.collision.keep
    for foot in obstacle.collision.feet:
        now, before = surface[np.isin(keep, foot).nonzero()[0]], skin[np.intersect1d(keep, foot)]
        assert np.abs(np.ptp(now, axis=0) - np.ptp(before, axis=0)).max() < 0.02
    crossing = self_intersecting_faces(surface.astype(float), obstacle.collision.faces)
    assert crossing.mean() < 0.01


def test_a_body_without_these_joints_collides_with_its_skin(obstacle: Obstacle) -> None:
    import dataclasses

    from tryon_jax.physics.proxy import build_collision_body

    names = tuple(f"joint{k}" for k in range(len(obstacle.body.joint_names)))
    plain = build_collision_body(dataclasses.replace(obstacle.body, joint_names=names))
    np.testing.assert_array_equal(plain.faces, np.asarray(obstacle.body.faces))
    skin = obstacle.skin(np.zeros(2))
    np.testing.assert_allclose(plain.vertices(skin), skin, atol=1e-6)
