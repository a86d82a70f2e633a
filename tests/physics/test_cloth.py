"""The rest state: geometry, seams, sparsity, padding, and meshes that have none."""

import dataclasses

import jax
import numpy as np
import pytest
from cloth_scenes import make_cloth, make_fabric, place, sheet, wavy

from tryon_jax.mesh.topology import hinges
from tryon_jax.physics.cloth import build_cloth
from tryon_jax.physics.elasticity import deform, elastic_gradient

internal = jax.jit(lambda x, cloth, fabric: elastic_gradient(deform(x, cloth, fabric), cloth))


def test_areas_and_gradients(x64: None) -> None:
    faces, uv = sheet(4, 3, 0.08, 0.09)
    cloth = make_cloth(faces, uv)
    assert float(cloth.face_areas.sum()) == pytest.approx(0.08 * 0.09)
    assert float(cloth.vertex_areas.sum()) == pytest.approx(0.08 * 0.09)
    assert int(cloth.active.sum()) == len(uv)
    # Hat functions: 1 at their own corner, 0 at the others, for any linear field.
    values = np.asarray(cloth.shape_gradients)[: len(faces)]
    np.testing.assert_allclose(
        np.einsum("fnk,fnc->fkc", values, uv[faces]), np.tile(np.eye(2), (len(faces), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(values.sum(axis=1), 0, atol=1e-9)


def test_hinges_of_a_sheet(x64: None) -> None:
    faces, uv = sheet(4, 3, 0.08, 0.06)
    cloth = make_cloth(faces, uv)
    edges, _ = hinges(faces, len(uv))
    lengths = np.linalg.norm(uv[edges[:, 1]] - uv[edges[:, 0]], axis=1)
    area = 0.02 * 0.02
    np.testing.assert_allclose(cloth.hinge_shape[: len(edges)], lengths**2 / (4 * area))
    np.testing.assert_allclose(cloth.hinge_curvature[: len(edges)], lengths / (2 * area))
    vectors = np.abs(uv[edges[:, 1]] - uv[edges[:, 0]])
    expected = np.arctan2(vectors[:, 1], vectors[:, 0])
    np.testing.assert_allclose(cloth.hinge_grain[: len(edges)], np.stack([expected, expected], axis=1), atol=1e-12)
    assert not np.asarray(cloth.hinge_shape)[len(edges) :].any()


def tube(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """A sheet whose first and last columns are sewn together: faces, uv, faces_uv, welded vertices."""
    faces_uv, uv = sheet(columns, rows, 0.02 * columns, 0.02 * rows)
    welded = np.arange(len(uv))
    welded[columns * (rows + 1) :] = np.arange(rows + 1)
    return welded[faces_uv], uv, faces_uv, columns * (rows + 1)


def test_a_seam_is_a_hinge_like_any_other(x64: None) -> None:
    """A tube is the same all around: nothing shows where it was sewn."""
    faces, uv, faces_uv, count = tube(6, 3)
    cloth = build_cloth(faces, uv, faces_uv, count, bucket=64, dtype=np.float64)
    rows = np.asarray(cloth.vertex_areas)[:count].reshape(6, 4)
    np.testing.assert_allclose(rows[::2], rows[:1].repeat(3, axis=0))
    angle = np.pi / 3 * np.arange(6)
    ring = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1) * 0.02
    points = ring[:, None, :] + np.stack([np.zeros(4), 0.02 * np.arange(4), np.zeros(4)], axis=1)[None]
    gradient = internal(place(points.reshape(-1, 3), cloth), cloth, make_fabric())
    # Every second column alike, turned by 120 degrees.
    force = np.asarray(gradient)[:count].reshape(6, 4, 3)
    cos, sin = np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3)
    turn = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    assert np.abs(force).max() > 1e-8
    np.testing.assert_allclose(force[2], force[0] @ turn.T, atol=1e-9 * np.abs(force).max())


def test_padding_does_not_change_forces(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    points, fabric = wavy(uv, 1), make_fabric()
    results = []
    for bucket in (64, 96):
        cloth = make_cloth(faces, uv, bucket=bucket)
        assert len(cloth.vertex_areas) == bucket
        results.append(np.asarray(internal(place(points, cloth), cloth, fabric)))
    np.testing.assert_array_equal(results[0][: len(uv)], results[1][: len(uv)])
    assert not results[1][len(uv) :].any()


def test_cloths_of_a_bucket_have_the_same_shapes() -> None:
    few, many = (
        jax.tree.leaves(make_cloth(*sheet(columns, rows, 0.1, 0.1), dtype=np.float32))
        for columns, rows in ((3, 2), (6, 7))
    )
    assert [leaf.shape for leaf in few] == [leaf.shape for leaf in many]
    assert {leaf.dtype for leaf in few} == {np.dtype(np.float32), np.dtype(np.int32)}


def test_degenerate_and_inverted_rest_triangles() -> None:
    faces, uv = sheet(3, 3, 0.06, 0.06)
    flat = uv.copy()
    flat[5] = flat[4]
    with pytest.raises(ValueError, match=r"face \d+ has rest area .* inverted or degenerate"):
        make_cloth(faces, flat)
    folded = uv.copy()
    folded[5] += [0.05, 0.0]
    with pytest.raises(ValueError, match=r"face \d+ is inverted"):
        make_cloth(faces, folded)
    broken = uv.copy()
    broken[3, 1] = np.nan
    with pytest.raises(ValueError, match=r"uv must be finite, but entry \(3, 1\)"):
        make_cloth(faces, broken)


def test_a_mirrored_panel_is_not_inverted() -> None:
    """The two sides of a garment may be drawn mirrored, each consistently."""
    faces, uv, faces_uv, count = tube(6, 3)
    both = np.concatenate([faces_uv, faces_uv + len(uv)])
    mirrored = np.concatenate([uv, uv * [-1, 1]])
    cloth = build_cloth(np.concatenate([faces, faces + count]), mirrored, both, 2 * count, bucket=64)
    assert float(cloth.face_areas.sum()) == pytest.approx(2 * 0.12 * 0.06, rel=1e-5)


def test_a_mesh_that_does_not_fit_its_bucket() -> None:
    # Loose triangles have three vertices each: more faces than two per vertex cannot happen, more hinges can.
    faces = np.array([[0, 1, k] for k in range(2, 20)])
    uv = np.concatenate([[[0.0, 0.0], [1.0, 0.0]], np.stack([np.linspace(0, 1, 18), np.ones(18)], axis=1)])
    cloth = build_cloth(faces[:2], uv, faces[:2], 20, bucket=4)
    assert dataclasses.is_dataclass(cloth)
    many = np.concatenate([faces] * 3)
    with pytest.raises(ValueError, match="does not fit its bucket"):
        build_cloth(many, uv, many, 20, bucket=20)
