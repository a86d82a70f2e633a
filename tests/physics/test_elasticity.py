"""Sums over elements: gathered by the tables of a mesh, they are those of a loop over its elements."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import make_cloth, make_fabric, place, sheet, wavy

from tryon_jax.physics.bending import hinge_roots
from tryon_jax.physics.block_matrix import BlockMatrix
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.elasticity import Deformation, deform, elastic_blocks, elastic_gradient
from tryon_jax.physics.incidence import find_incidence
from tryon_jax.physics.stretch import face_gradient, face_hessian

SIDES = ((0, 1), (1, 2), (2, 0))


def tube() -> Cloth:
    """A sheet sewn to a tube: its vertices have four neighbours or eight, those of its borders three or five."""
    faces_uv, uv = sheet(6, 4, 0.12, 0.08)
    welded = np.arange(len(uv))
    welded[30:] = np.arange(5)
    return build_cloth(welded[faces_uv], uv, faces_uv, 30, bucket=48, dtype=np.float64)


def deformed(cloth: Cloth, seed: int) -> Deformation:
    x = place(wavy(sheet(5, 5, 0.1, 0.1)[1][:30], seed), cloth)
    return deform(x, cloth, make_fabric())


def dense(matrix: BlockMatrix, cloth: Cloth) -> np.ndarray:
    """The matrix [row, column, xyz, xyz]."""
    neighbours = np.asarray(cloth.incidence.neighbours)
    slots, count = neighbours.shape
    found = np.zeros((count, count, 3, 3))
    rows = np.tile(np.arange(count), slots)
    np.add.at(found, (rows, neighbours.ravel()), np.asarray(matrix.beside).transpose(0, 3, 1, 2).reshape(-1, 3, 3))
    found[np.arange(count), np.arange(count)] += np.asarray(matrix.diagonal).transpose(2, 0, 1)
    return found


def looped(cloth: Cloth, sides: np.ndarray, roots: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """The same, element by element."""
    count = len(cloth.vertex_areas)
    found = np.zeros((count, count, 3, 3))
    for f, face in enumerate(np.asarray(cloth.faces)):
        for side, (i, j) in enumerate(SIDES):
            block = sides[:, :, side, f]
            found[face[i], face[j]] += block
            found[face[j], face[i]] += block.T
            found[face[i], face[i]] -= block
            found[face[j], face[j]] -= block.T
        found[np.ix_(face, face)] += shared[f]
    for h, hinge in enumerate(np.asarray(cloth.hinges)):
        for i in range(4):
            for j in range(4):
                factor = 2 if i == j >= 2 else 0 if {i, j} == {2, 3} else 1
                found[hinge[i], hinge[j]] += factor * np.outer(roots[:, i, h], roots[:, j, h])
    return found


@pytest.mark.parametrize("seed", [0, 1])
def test_blocks_are_the_sum_over_elements(x64: None, seed: int) -> None:
    cloth, fabric = tube(), make_fabric()
    deformation = deformed(cloth, seed)
    # Contact of faces as well: any symmetric blocks, none on padding.
    shared = np.random.default_rng(seed).normal(size=(len(cloth.faces), 3, 3)) * 1e3
    shared = (shared + shared.transpose(0, 2, 1)) * (np.asarray(cloth.face_areas) > 0)[:, None, None]
    state = deformation.gradients, deformation.strain, deformation.stress
    sides = np.asarray(face_hessian(*state, cloth, fabric))
    roots = np.asarray(hinge_roots(deformation.stiffness, deformation.slope))
    expected = looped(cloth, sides, roots, shared)
    size = np.abs(expected).max()
    found = dense(elastic_blocks(deformation, cloth, fabric, jnp.asarray(shared)), cloth)
    np.testing.assert_allclose(found, expected, atol=1e-12 * size)
    # Without contact: symmetric and positive semi-definite.
    bare = dense(elastic_blocks(deformation, cloth, fabric), cloth)
    np.testing.assert_allclose(bare, looped(cloth, sides, roots, 0 * shared), atol=1e-12 * size)
    matrix = bare.transpose(0, 2, 1, 3).reshape(3 * len(bare), -1)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * size)
    assert np.linalg.eigvalsh(matrix).min() > -1e-9 * size


def test_gradient_is_the_sum_over_elements(x64: None) -> None:
    cloth = tube()
    deformation = deformed(cloth, 2)
    expected = np.zeros((len(cloth.vertex_areas), 3))
    np.add.at(expected, np.asarray(cloth.faces), face_gradient(deformation.gradients, deformation.stress, cloth))
    moment = np.asarray(deformation.stiffness * deformation.angle)[:, None, None]
    np.add.at(expected, np.asarray(cloth.hinges), moment * np.asarray(deformation.slope))
    found = np.asarray(elastic_gradient(deformation, cloth))
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_single_precision_keeps_the_matrix_definite() -> None:
    """Rounding of the elastic blocks must stay far below the inertia that a step adds to them."""
    faces, uv = sheet(5, 5, 0.1, 0.1)
    fabric = make_fabric(warp=5000.0, shear=2000.0)
    cloth = make_cloth(faces, uv, np.float32)
    x = place(wavy(uv, 0, scale=0.02), cloth)
    blocks = jax.jit(lambda x: elastic_blocks(deform(x, cloth, fabric), cloth, fabric))(x)
    assert blocks.diagonal.dtype == jnp.float32
    found = dense(blocks, cloth).transpose(0, 2, 1, 3).reshape(192, 192)
    # 0.2 kg/m² on cells of 2 cm, steps of a thirtieth of a second.
    inertia = 0.2 * 4e-4 * 30**2
    assert np.linalg.eigvalsh(0.5 * (found + found.T)).min() > -0.05 * inertia


def test_a_mesh_with_more_edges_than_its_bucket_has_room_for() -> None:
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    hinges = np.array([[0, 1, 2, 3]])
    assert find_incidence(faces, hinges, 4, 3, 6).edges.shape[1] == 4
    with pytest.raises(ValueError, match="mesh with 5 edges does not fit its bucket of 5"):
        find_incidence(faces, hinges, 4, 3, 5)
