"""Plane cuts of shapes whose outlines are known."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from tryon_jax.body.measurements import tape_girth
from tryon_jax.mesh.plane_cut import cut_mesh, tape_length
from tryon_jax.mesh.topology import unique_edges

UP = np.array([0.0, 0.0, 1.0])


def test_a_torus_across_its_hole_has_two_circles() -> None:
    torus = trimesh.creation.torus(major_radius=0.3, minor_radius=0.1, major_sections=200, minor_sections=60)
    points, faces = np.asarray(torus.vertices), np.asarray(torus.faces)
    curves = cut_mesh(points, faces, np.array([0.0, 0.0, 0.03]), UP)
    assert len(curves) == 2
    assert all(curve.closed for curve in curves)
    half = np.sqrt(0.1**2 - 0.03**2)
    lengths = sorted(curve.length(points[faces]) for curve in curves)
    np.testing.assert_allclose(lengths, 2 * np.pi * np.array([0.3 - half, 0.3 + half]), rtol=5e-3)
    for curve in curves:
        ends = curve.at(points[faces])
        np.testing.assert_allclose(ends[..., 2], 0.03, atol=1e-12)
        # Every end lies between the two vertices of its edge.
        start, end = np.moveaxis(points[curve.edges(faces)], 2, 0)
        share = curve.fractions[..., None]
        np.testing.assert_allclose(ends, (1 - share) * start + share * end, atol=1e-12)
    assert cut_mesh(points, faces, np.array([0.0, 0.0, 0.2]), UP) == []


def test_a_curve_that_meets_a_border_is_open() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    faces = np.asarray(ball.faces)
    opened = faces[ball.vertices[faces][:, :, 0].mean(axis=1) < 0.8]
    (curve,) = cut_mesh(np.asarray(ball.vertices), opened, np.array([0.0, 0.0, 0.01]), UP)
    assert not curve.closed


def test_tape_is_the_one_that_gradients_pass_through(x64: None) -> None:
    """Measurements of bodies have the same tape as a function of all cut edges, for derivatives."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    points, faces = ball.vertices * [0.3, 0.2, 0.4], np.asarray(ball.faces)
    normal = np.array([0.2, 0.1, 1.0]) / np.linalg.norm([0.2, 0.1, 1.0])
    (curve,) = cut_mesh(points, faces, 0.05 * normal, normal)
    host = tape_length(curve.at(points[faces]).reshape(-1, 3), normal)
    edges = unique_edges(faces, len(points))[0]
    device = tape_girth(jnp.asarray(points), jnp.asarray(edges), jnp.asarray(0.05), jnp.asarray(normal))
    assert float(device) == pytest.approx(host, rel=3e-4)
    assert curve.length(points[faces]) == pytest.approx(host, rel=1e-3)
