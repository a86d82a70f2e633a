"""The rest state from the pattern's coordinates is the one that is built on the host, and has its derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import BUCKET, make_cloth, sheet

from tryon_jax.physics.cloth import build_cloth
from tryon_jax.physics.rest_shape import find_rest_corners, with_rest_shape

FACES, UV = sheet(5, 4, 0.1, 0.08)
FIELDS = ("shape_gradients", "face_areas", "hinge_shape", "hinge_curvature", "vertex_areas")


@pytest.mark.usefixtures("x64")
def test_the_same_as_on_the_host() -> None:
    cloth = make_cloth(FACES, UV)
    corners = find_rest_corners(cloth, FACES, FACES, len(UV))
    other = UV * [1.2, 0.9] + 0.01 * np.sin(30 * UV[:, ::-1])
    found = jax.jit(with_rest_shape)(cloth, corners, jnp.asarray(other))
    wanted = make_cloth(FACES, other)
    for field in dataclasses.fields(wanted):
        if field.name == "hinge_grain":
            real = np.asarray(wanted.hinge_shape) > 0
            np.testing.assert_allclose(found.hinge_grain[real], wanted.hinge_grain[real], atol=1e-9)
        elif field.name in FIELDS:
            np.testing.assert_allclose(getattr(found, field.name), getattr(wanted, field.name), rtol=1e-9, atol=1e-12)


@pytest.mark.usefixtures("x64")
def test_a_seam_has_an_edge_in_either_panel() -> None:
    # Two triangles that are sewn along an edge, apart in the pattern and of different length there.
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    uv = np.array([[0.0, 0], [0.1, 0], [0.05, 0.1], [1.12, 0], [1.0, 0], [1.05, 0.1]])
    faces_uv = np.array([[0, 1, 2], [4, 3, 5]])
    cloth = build_cloth(faces, uv, faces_uv, 4, bucket=BUCKET, dtype=np.float64)
    corners = find_rest_corners(cloth, faces, faces_uv, 4)
    found = with_rest_shape(cloth, corners, jnp.asarray(uv))
    np.testing.assert_allclose(found.hinge_shape, cloth.hinge_shape, rtol=1e-12)
    np.testing.assert_allclose(found.shape_gradients, cloth.shape_gradients, rtol=1e-12)


@pytest.mark.usefixtures("x64")
def test_derivatives_are_finite_and_those_of_the_area() -> None:
    cloth = make_cloth(FACES, UV)
    corners = find_rest_corners(cloth, FACES, FACES, len(UV))

    def area(scale: jax.Array) -> jax.Array:
        return with_rest_shape(cloth, corners, jnp.asarray(UV) * scale[None, :]).face_areas.sum()

    np.testing.assert_allclose(jax.grad(area)(jnp.ones(2)), 0.1 * 0.08, rtol=1e-12)

    def everything(uv: jax.Array) -> jax.Array:
        changed = with_rest_shape(cloth, corners, uv)
        return sum((jnp.asarray(getattr(changed, name)) ** 2).sum() for name in FIELDS)

    assert np.isfinite(jax.grad(everything)(jnp.asarray(UV))).all()
