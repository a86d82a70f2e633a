"""Linear blend skinning against rigid motions and a plain loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tryon_jax.body import load_body, pose_body, shape_body
from tryon_jax.body.pose import rotation_matrix

BODY = load_body("female")
pose_fast = jax.jit(pose_body)
angles = st.lists(st.floats(-4, 4, width=32), min_size=3, max_size=3)


@given(vector=angles)
def test_rotations_agree_with_scipy(vector: list[float]) -> None:
    expected = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(rotation_matrix(jnp.asarray(vector, jnp.float32)), expected, atol=2e-6)


@pytest.mark.parametrize("size", [0.0, 1e-6, 1e-4, 1.2e-4, 1e-2])
def test_small_rotations_are_exact_and_differentiable(size: float, x64: None) -> None:
    vector = size * jnp.asarray([0.6, 0.0, -0.8])
    np.testing.assert_allclose(rotation_matrix(vector), Rotation.from_rotvec(np.array(vector)).as_matrix(), atol=1e-15)
    slope = jax.jacfwd(rotation_matrix)(vector)
    assert bool(jnp.isfinite(slope).all())
    np.testing.assert_allclose(slope[2, 1], [1, 0, 0], atol=2 * size + 1e-12)


def test_no_pose_is_the_tpose() -> None:
    betas = jnp.asarray([1.0, -1.0, 0.5])
    vertices, joints = pose_body(BODY, betas, jnp.zeros((24, 3)))
    shaped, at = shape_body(BODY, betas)
    np.testing.assert_allclose(vertices, shaped, atol=2e-6)
    np.testing.assert_allclose(joints, at, atol=1e-6)


@given(vector=angles)
def test_turning_the_root_turns_the_body_about_its_pelvis(vector: list[float]) -> None:
    pose = jnp.zeros((24, 3)).at[0].set(jnp.asarray(vector, jnp.float32))
    vertices, joints = pose_fast(BODY, jnp.zeros(10), pose)
    turn = Rotation.from_rotvec(vector).as_matrix()
    shaped, at = shape_body(BODY, jnp.zeros(10))
    np.testing.assert_allclose(vertices, np.asarray(shaped) @ turn.T, atol=1e-5)
    np.testing.assert_allclose(joints, np.asarray(at) @ turn.T, atol=1e-5)


def test_skinning_agrees_with_four_by_four_matrices(x64: None) -> None:
    rng = np.random.default_rng(3)
    body = jax.tree.map(
        lambda leaf: np.asarray(leaf, np.float64) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, BODY
    )
    directions = 0.01 * rng.normal(size=(207, body.v_template.shape[0], 3))
    body = type(body)(**{**vars(body), "posedirs": directions})
    betas, pose = rng.normal(size=10), rng.normal(size=(24, 3)) * 0.5
    vertices, joints = pose_body(body, jnp.asarray(betas), jnp.asarray(pose))

    local = Rotation.from_rotvec(pose).as_matrix()
    shaped = np.asarray(body.v_template) + np.asarray(body.shapedirs) @ betas
    at = np.asarray(body.J_regressor) @ shaped
    shaped = shaped + np.tensordot((local[1:] - np.eye(3)).ravel(), directions, 1)
    world = np.tile(np.eye(4), (24, 1, 1))
    for joint, parent in enumerate(body.parents):
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = local[joint], at[joint] - (at[parent] if parent >= 0 else 0)
        world[joint] = (world[parent] if parent >= 0 else np.eye(4)) @ step
    np.testing.assert_allclose(joints, world[:, :3, 3], atol=1e-12)
    back = np.tile(np.eye(4), (24, 1, 1))
    back[:, :3, 3] = -at
    blended = np.einsum("vj,jab->vab", np.asarray(body.lbs_weights), world @ back)
    expected = np.einsum("vab,vb->va", blended, np.c_[shaped, np.ones(len(shaped))])[:, :3]
    np.testing.assert_allclose(vertices, expected, atol=1e-7)  # the weights are float32, so rows sum to 1 only nearly


def test_gradients_to_pose_and_batches() -> None:
    def reach(pose: jax.Array) -> jax.Array:
        return pose_body(BODY, jnp.zeros(2), pose)[1][22, 1]

    slope = jax.grad(reach)(jnp.zeros((24, 3)))
    assert bool(jnp.isfinite(slope).all())
    assert float(slope[16, 2]) > 0.3  # raising the left arm about z lifts the hand by the arm's length
    many = jax.jit(jax.vmap(pose_body, in_axes=(None, None, 0)))(BODY, jnp.zeros(2), jnp.zeros((2, 24, 3)))
    assert many[0].shape == (2, 6774, 3)


def test_a_pose_of_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\[24, 3\].*\(23, 3\)"):
        pose_body(BODY, jnp.zeros(2), jnp.zeros((23, 3)))
