"""Strain, fine parts, folds and self-intersections of shapes with known answers."""

import numpy as np
import pytest
import trimesh
from graph_meshes import disc, tube

from tryon_jax.graph.smoothing import make_smoother
from tryon_jax.metrics import (
    area_strain,
    compare_wrinkles,
    edge_strain,
    fine_part,
    fold_angles,
    fold_statistics,
    self_intersecting_share,
)


def test_strain_of_a_stretched_sheet():
    points, faces = disc(100)
    rest = points[:, :2]
    drape = np.column_stack([1.1 * rest[:, 0], np.zeros(len(rest)), 1.1 * rest[:, 1]])
    np.testing.assert_allclose(edge_strain(drape, faces, rest, faces), 0.1, atol=1e-12)
    np.testing.assert_allclose(area_strain(drape, faces, rest, faces), 0.21, atol=1e-12)
    # Rest positions may be numbered otherwise than the drape, as UV is at seams.
    turned = np.arange(len(rest))[::-1]
    np.testing.assert_allclose(edge_strain(drape, faces, rest[turned], len(rest) - 1 - faces), 0.1, atol=1e-12)


def test_the_fine_part_of_a_wavy_sheet_is_its_waves():
    size = np.linspace(0, 0.6, 61)
    x, z = np.meshgrid(size, size, indexing="ij")
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    flat = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)
    number, length = 2 * np.pi / 0.1, 0.02
    wave = flat + np.stack([0 * x, 0.004 * np.sin(number * x), 0 * x], axis=-1).reshape(-1, 3)
    smoother = make_smoother(flat, faces, length)
    found = fine_part(smoother, wave[None].astype(np.float32))[0]
    middle = ((np.abs(flat - np.array([[0.3, 0, 0.3]])) < 0.15).all(axis=1)).nonzero()[0]
    # Heat flow for the time length² leaves exp(−(number length)²) of a wave.
    kept = 1 - np.exp(-((number * length) ** 2))
    np.testing.assert_allclose(found[middle, 1], kept * wave[middle, 1], atol=6e-5)
    np.testing.assert_allclose(found[middle][:, [0, 2]], 0.0, atol=1e-5)


def test_wrinkles_are_compared_in_size_variation_and_place():
    rng = np.random.default_rng(0)
    constant = rng.normal(size=(1, 500, 3))
    varying = rng.normal(size=(8, 500, 3))
    varying -= varying.mean(axis=0, keepdims=True)
    simulated = constant + varying
    same = compare_wrinkles(simulated, simulated)
    assert (same.total, same.varying) == (1.0, 1.0)
    assert same.correlation == pytest.approx(1.0)
    assert same.simulated_varying == pytest.approx(np.sqrt((varying**2).sum(-1).mean()))
    half = compare_wrinkles(constant + 0.5 * varying, simulated)
    assert half.varying == pytest.approx(0.25)
    assert half.correlation == pytest.approx(1.0)
    still = compare_wrinkles(np.broadcast_to(constant, simulated.shape), simulated)
    assert still.varying == pytest.approx(0.0, abs=1e-12)
    assert still.correlation == 0.0
    other = compare_wrinkles(constant + rng.permutation(varying, axis=1), simulated)
    assert other.varying == pytest.approx(1.0)
    assert abs(other.correlation) < 0.1
    with pytest.raises(ValueError, match="at least 2 body shapes"):
        compare_wrinkles(simulated[:1], simulated[:1])


def test_fold_angles_have_the_sign_of_the_bulge():
    points = np.array([[0.0, 0, 0], [0.0, 0, 1], [-1.0, 0, 0.5], [1.0, 0, 0.5]])
    faces = np.array([[1, 0, 2], [0, 1, 3]])
    for lift, expected in ((0.0, 0.0), (-1.0, np.pi / 2), (1.0, -np.pi / 2)):
        bent = points.copy()
        bent[2:, 1] = lift
        # Both wings go down from the ridge (a roof) or up (a valley), by 45 degrees each.
        normal = np.cross(bent[faces[0, 1]] - bent[faces[0, 0]], bent[faces[0, 2]] - bent[faces[0, 0]])
        oriented = faces if normal[1] > 0 else faces[:, ::-1]
        np.testing.assert_allclose(fold_angles(bent, oriented), expected, atol=1e-12)


def test_fold_statistics_of_a_sphere_inside_and_out():
    ball = trimesh.creation.icosphere(4, 0.2)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    found = fold_statistics(vertices, faces)
    assert found.curvature == pytest.approx(5.0, rel=0.02)
    assert found.sharp == pytest.approx(5.0, rel=0.2)
    assert found.concave == 0.0
    assert fold_statistics(vertices, faces[:, ::-1]).concave == pytest.approx(1.0)
    twice = fold_statistics(2 * vertices, faces)
    assert twice.curvature == pytest.approx(found.curvature / 2)


def test_self_intersections_are_shares_of_faces():
    points, faces = tube()
    assert self_intersecting_share(points, faces) == 0.0
    through = points.copy()
    through[0] = [-0.5, 0.0, 0.0]
    assert 0.0 < self_intersecting_share(through, faces) < 0.5
