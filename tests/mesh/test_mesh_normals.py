"""Normals of the host and of the device are the same."""

import numpy as np
import trimesh

from tryon_jax.body import vertex_normals as on_device
from tryon_jax.mesh.normals import vertex_normals


def test_normals_of_a_sphere_point_outwards() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=3)
    normals = vertex_normals(np.asarray(sphere.vertices), np.asarray(sphere.faces))
    np.testing.assert_allclose(normals, sphere.vertices, atol=0.02)


def test_host_and_device_agree_also_where_no_face_meets() -> None:
    rng = np.random.default_rng(0)
    points, faces = rng.normal(size=(30, 3)), rng.integers(0, 29, (40, 3))
    normals = vertex_normals(points, faces)
    np.testing.assert_allclose(on_device(points.astype(np.float32), faces), normals, atol=2e-5)
    np.testing.assert_array_equal(normals[29], 0.0)
