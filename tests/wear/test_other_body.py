from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.body import load_body, shape_body
from tryon_jax.wear.other_body import prepare_other_body


@pytest.fixture(scope="module")
def known():
    return load_body("female")


def skin(body, betas):
    return np.asarray(shape_body(body, jnp.asarray(betas, jnp.float32))[0], np.float64)


def test_the_same_body_is_its_own_nearest_and_moves_nothing(known):
    other = prepare_other_body(known, known, 2)
    betas = np.array([1.0, -0.5])
    np.testing.assert_allclose(other.nearest_betas(skin(known, betas).astype(np.float32)), betas, atol=0.05)
    vertices = skin(known, betas)
    moved = other.transfer(vertices, np.asarray(known.lbs_weights), betas, betas)
    np.testing.assert_allclose(moved, vertices, atol=1e-5)


def test_the_skin_of_one_body_comes_near_to_that_of_another(known):
    """The embedded bodies share their topology: the carried skin can be compared vertex by vertex."""
    male = load_body("male")
    other = prepare_other_body(male, known, 2)
    betas = np.array([0.5, 0.5])
    target = skin(male, betas)
    nearest = other.nearest_betas(target.astype(np.float32))
    start = skin(known, nearest)
    moved = other.transfer(start, np.asarray(known.lbs_weights), nearest, betas)
    before, after = (np.linalg.norm(points - target, axis=1).mean() for points in (start, moved))
    assert after < 0.7 * before


def test_bodies_that_cannot_be_dressed_are_refused(known):
    with pytest.raises(ValueError, match=r"body 'open' cannot be dressed: the surface must be closed"):
        prepare_other_body(replace(known, faces=known.faces[1:], name="open"), known, 2)
    names = tuple("elbow" if name == "L_elbow" else name for name in known.joint_names)
    with pytest.raises(ValueError, match="lacks the joints L_elbow"):
        prepare_other_body(replace(known, joint_names=names), known, 2)
