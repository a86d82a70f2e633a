"""Meshes of near designs: the same triangles, as even, at the same places of the template."""

import numpy as np
import pytest

from tryon_jax.garment import build_template, load_design_space, place_on_template, remesh
from tryon_jax.garment.near_design import MOST_DENSITY_CHANGE, mesh_of_near_design

SPACE = load_design_space()
MESH = remesh(SPACE, SPACE.preset("tshirt"), 4e-4)
OTHER = SPACE.design("longer", sleeve_length=0.17, chest=1.04, length=0.66)


def test_the_pattern_is_that_of_the_other_design_and_the_triangles_are_the_same():
    moved, anew = mesh_of_near_design(SPACE, MESH, OTHER), remesh(SPACE, OTHER, 4e-4)
    assert moved is not None
    assert moved.design is OTHER
    np.testing.assert_array_equal(moved.faces, MESH.faces)
    assert moved.quality.total_area == pytest.approx(anew.quality.total_area, rel=1e-3)
    assert moved.quality.max_distortion < 2.5
    # Panels are as wide and as long.
    np.testing.assert_allclose(np.ptp(moved.uv, axis=0), np.ptp(anew.uv, axis=0), atol=1e-9)


def test_seams_stay_closed_and_vertices_near_where_a_new_mesh_has_them():
    """Read as positions, the template's pattern puts every vertex where the moved pattern has it, to millimetres."""
    moved = mesh_of_near_design(SPACE, MESH, OTHER)
    assert moved is not None
    template = build_template(SPACE, OTHER)
    places = np.concatenate([template.uv[template.vertex_uv], np.zeros((template.num_vertices, 1))], axis=1)
    off = np.linalg.norm(place_on_template(moved, places)[:, :2] - moved.uv[moved.vertex_uv], axis=1)
    before = build_template(SPACE, MESH.design)
    flat = np.concatenate([before.uv[before.vertex_uv], np.zeros((before.num_vertices, 1))], axis=1)
    usual = np.linalg.norm(place_on_template(MESH, flat)[:, :2] - MESH.uv[MESH.vertex_uv], axis=1)
    assert off.mean() < usual.mean() + 2e-3
    for pair in moved.seam_uv.values():
        one, other = (np.linalg.norm(np.diff(moved.uv[pair[:, k]], axis=0), axis=1) for k in range(2))
        np.testing.assert_allclose(one.sum(), other.sum(), rtol=0.02)


def test_a_design_that_is_too_far_is_refused():
    far = SPACE.from_values(SPACE.maximum)
    assert mesh_of_near_design(SPACE, MESH, far) is None
    assert mesh_of_near_design(SPACE, MESH, OTHER, max_distortion=1.2) is None
    # Well shaped, but of too large triangles.
    wider = SPACE.design("wider", sleeve_length=0.15, chest=1.02, length=0.64 * (1 + 1.5 * MOST_DENSITY_CHANGE))
    assert mesh_of_near_design(SPACE, MESH, wider, max_distortion=10.0) is None
