import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.body import load_body, pose_body, shape_body
from tryon_jax.graph.skinning import soft_skinning
from tryon_jax.wear.posing import pose_dressed, read_pose


@pytest.fixture(scope="module")
def dressed():
    """The body with its own skin as garment."""
    body = load_body("female")
    vertices = shape_body(body, jnp.asarray([1.0, -0.5]))[0]
    return body, vertices


def test_a_garment_of_skin_moves_as_the_skin_does(dressed):
    body, vertices = dressed
    pose = np.random.default_rng(0).normal(size=(24, 3)) * 0.4
    expected, _ = pose_body(body, jnp.asarray([1.0, -0.5]), pose.astype(np.float32))
    posed, garment = pose_dressed(body, vertices, vertices[100:200], body.lbs_weights[100:200], pose.astype(np.float32))
    np.testing.assert_allclose(posed, expected, atol=2e-6)
    np.testing.assert_allclose(garment, expected[100:200], atol=2e-6)


def test_no_pose_changes_nothing(dressed):
    body, vertices = dressed
    posed, garment = pose_dressed(body, vertices, vertices, body.lbs_weights, np.zeros((24, 3), np.float32))
    np.testing.assert_allclose(posed, vertices, atol=1e-6)
    np.testing.assert_allclose(garment, vertices, atol=1e-6)


def test_soft_weights_have_no_jumps_and_still_sum_to_one():
    """A strip of cloth whose left half follows one leg and whose right half follows the other."""
    columns = 60
    index = np.arange(2 * columns).reshape(2, columns)
    a, b, c, d = index[0, :-1], index[0, 1:], index[1, :-1], index[1, 1:]
    faces = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    left = (np.arange(columns) < columns // 2).astype(float)
    weights = np.stack([np.tile(left, 2), 1 - np.tile(left, 2)], axis=1)
    soft = soft_skinning(weights, faces)
    np.testing.assert_allclose(soft.sum(axis=1), 1)
    assert np.abs(np.diff(weights[:columns, 0])).max() == 1
    assert np.abs(np.diff(soft[:columns, 0])).max() < 0.15
    assert soft[0, 0] > 0.99
    assert soft[columns - 1, 0] < 0.01


def test_pose_files(tmp_path):
    pose = np.random.default_rng(0).normal(size=(24, 3))
    np.savez(tmp_path / "pose.npz", pose=pose.ravel())
    np.testing.assert_array_equal(read_pose(tmp_path / "pose.npz", 24), pose)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"poses": np.zeros((24, 3))}, r"no array 'pose' \(it has \['poses'\]\)"),
        ({"pose": np.zeros((10, 24, 3))}, "must be 24 axis-angle vectors"),
        ({"pose": np.full((24, 3), np.nan)}, "pose must be finite"),
        ({"pose": np.array([{}] * 72, object)}, "not a readable .npz of plain arrays"),
    ],
)
def test_bad_pose_files_are_named(tmp_path, arrays, message):
    np.savez(tmp_path / "pose.npz", **arrays)
    with pytest.raises(ValueError, match=message):
        read_pose(tmp_path / "pose.npz", 24)


def test_a_text_file_is_no_pose(tmp_path):
    (tmp_path / "pose.npz").write_text("T-pose")
    with pytest.raises(ValueError, match="not a readable"):
        read_pose(tmp_path / "pose.npz", 24)
