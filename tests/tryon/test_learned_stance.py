"""R_stance: nothing in T-pose, skinned change elsewhere, batches, gradients, own meshes, files."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.tryon.test_drape_fields import make_model
from tests.tryon.test_tryon import TINY
from tryon_jax.body import shape_body
from tryon_jax.body.stance import LOWEST, arms_pose
from tryon_jax.graph.skinning import garment_skinning
from tryon_jax.mesh.topology import unique_edges
from tryon_jax.nets.config import stance_config
from tryon_jax.nets.fabric_functions import fit_fabric_functions
from tryon_jax.physics.fabric_numbers import fabric_numbers
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.tryon import Garment, TryOnModel, drape, prepare
from tryon_jax.tryon.model import StanceNetwork
from tryon_jax.tryon.stance import init_stance, stance_fields, stand
from tryon_jax.tryon.stance_file import add_stance, save_stance
from tryon_jax.wear.posing import pose_dressed

FABRICS = ("gray-interlock", "white-dots-on-blk")
BETAS = jnp.array([[0.5, -1.0], [1.0, 2.0]])
make, standing = jax.jit(stance_fields, static_argnames="fabric"), jax.jit(stand)
draped = jax.jit(drape, static_argnames="fabric")


def with_stance(model: TryOnModel) -> TryOnModel:
    """The model with an R_stance whose fabrics differ."""
    config = stance_config(model.config, FABRICS, fine=model.config.fine, fields=3, fabric_functions=2)
    network = init_stance(jax.random.key(7), config, model.body)
    numbers = np.stack([np.asarray(fabric_numbers(load_fabric(name))) for name in FABRICS])
    functions = fit_fabric_functions(numbers, np.array([[1.0, 0.5], [0.8, -1.0]]))
    stage = replace(network.stage, fabrics=functions, scale=jnp.asarray(0.2))
    return replace(model, stance=StanceNetwork(stage, config))


@pytest.fixture(scope="module")
def model() -> TryOnModel:
    return with_stance(make_model())


@pytest.fixture(scope="module")
def garment(model: TryOnModel) -> Garment:
    return prepare(model, {"sleeve_length": 0.2})


@pytest.fixture(scope="module")
def skinning(model: TryOnModel, garment: Garment) -> np.ndarray:
    weights = garment_skinning(garment.mean_vertices, garment.faces, model.body).astype(np.float32)
    return np.pad(weights, ((0, garment.graph.num_nodes - len(weights)), (0, 0)))


def test_nothing_changes_in_t_pose(model: TryOnModel, garment: Garment, skinning: np.ndarray) -> None:
    vertices = draped(model, garment, BETAS)
    found = standing(make(model, garment), model.body, BETAS, 0.0, vertices, skinning)
    np.testing.assert_allclose(garment.unpad(found), garment.unpad(vertices), atol=2e-6)


def test_the_change_is_skinned_with_the_cloth(model: TryOnModel, garment: Garment, skinning: np.ndarray) -> None:
    fields = make(model, garment)
    still = replace(fields, fields=jnp.zeros_like(fields.fields))
    vertices = draped(model, garment, BETAS[0])
    found = standing(still, model.body, BETAS[0], 30.0, vertices, skinning)
    pose = arms_pose(model.body, 30.0).astype(np.float32)
    skin = np.asarray(shape_body(model.body, BETAS[0])[0])
    _, expected = pose_dressed(model.body, skin, vertices, skinning, pose)
    np.testing.assert_allclose(garment.unpad(found), garment.unpad(expected), atol=2e-6)
    changed = standing(fields, model.body, BETAS[0], 30.0, vertices, skinning)
    assert np.linalg.norm(garment.unpad(changed) - garment.unpad(found), axis=1).mean() > 1e-4


def test_bodies_and_stances_at_once_are_those_one_by_one(
    model: TryOnModel, garment: Garment, skinning: np.ndarray
) -> None:
    fields, vertices, degrees = make(model, garment), draped(model, garment, BETAS), jnp.array([12.0, 40.0])
    together = standing(fields, model.body, BETAS, degrees, vertices, skinning)
    for k in range(2):
        alone = standing(fields, model.body, BETAS[k], degrees[k], vertices[k], skinning)
        np.testing.assert_allclose(garment.unpad(together[k]), garment.unpad(alone), atol=2e-6)


def test_a_fabric_is_the_same_by_name_and_by_numbers(model: TryOnModel, garment: Garment) -> None:
    by_numbers = jax.jit(stance_fields)(model, garment, fabric_numbers(load_fabric(FABRICS[1])))
    np.testing.assert_allclose(by_numbers.fields, make(model, garment, fabric=FABRICS[1]).fields, atol=1e-6)
    first = make(model, garment)
    np.testing.assert_array_equal(first.fields, make(model, garment, fabric=FABRICS[0]).fields)
    assert np.abs(np.asarray(first.fields) - np.asarray(by_numbers.fields)).max() > 1e-4


def test_gradients_are_those_of_differences(
    model: TryOnModel, garment: Garment, skinning: np.ndarray, x64: None
) -> None:
    fields, vertices = make(model, garment), np.asarray(draped(model, garment, BETAS[0]))
    wide = jax.tree.map(lambda a: np.asarray(a, np.float64), (fields, vertices, skinning))
    body = jax.tree.map(lambda a: np.asarray(a, np.float64) if np.issubdtype(a.dtype, np.floating) else a, model.body)
    weight = jax.random.normal(jax.random.key(3), vertices.shape, jnp.float64)

    @jax.jit
    def value(state: jax.Array) -> jax.Array:
        return (stand(wide[0], body, state[:2], state[2], wide[1], wide[2]) * weight).sum()

    state, step = jnp.array([0.5, -1.0, 20.0]), 1e-4
    found = jax.grad(value)(state)
    for k in range(3):
        shift = jnp.zeros(3).at[k].set(step)
        np.testing.assert_allclose(found[k], (value(state + shift) - value(state - shift)) / (2 * step), rtol=1e-5)


def test_a_mesh_of_ones_own_moves_with_the_graph(model: TryOnModel, garment: Garment) -> None:
    faces, vertices = garment.faces, garment.mean_vertices
    edges, _ = unique_edges(faces, len(vertices))
    number = {tuple(edge): len(vertices) + k for k, edge in enumerate(np.sort(edges, axis=1).tolist())}
    fine = np.concatenate([vertices, vertices[edges].mean(axis=1)])
    middle = [[number[tuple(sorted((f[i], f[(i + 1) % 3])))] for i in range(3)] for f in faces.tolist()]
    quarters = [
        [(f[0], m[0], m[2]), (m[0], f[1], m[1]), (m[2], m[1], f[2]), m] for f, m in zip(faces, middle, strict=True)
    ]
    own = prepare(model, mesh=(fine, np.array([t for four in quarters for t in four])))
    assert own.own is not None
    carried = own.unpad(make(model, own).fields)
    graph = make(model, replace(own, own=None)).fields
    expected = np.einsum("mk,mkcf->mcf", own.own.weights, np.asarray(graph)[np.asarray(own.own.carriers)])
    np.testing.assert_allclose(carried, own.unpad(expected), atol=1e-6)


def test_a_file_gives_the_same_network_back(model: TryOnModel, garment: Garment, tmp_path: Path) -> None:
    assert model.stance is not None
    path = tmp_path / "stance.safetensors"
    save_stance(path, model.stance, model.body, {"stance": {"steps": 3}})
    again = add_stance(replace(model, stance=None), path)
    assert again.stance is not None
    assert again.stance.config == model.stance.config
    np.testing.assert_array_equal(make(again, garment).fields, make(model, garment).fields)


def test_what_does_not_fit_is_refused(model: TryOnModel, garment: Garment, tmp_path: Path) -> None:
    assert model.stance is not None
    with pytest.raises(ValueError, match="no R_stance"):
        stance_fields(replace(model, stance=None), garment)
    with pytest.raises(ValueError, match="fabric 'silk'"):
        stance_fields(model, garment, "silk")
    path = tmp_path / "stance.safetensors"
    save_stance(path, model.stance, model.body)
    other = replace(model, config=replace(TINY, pooling="select"), stance=None)
    with pytest.raises(ValueError, match=r"does not fit the model: config\.pooling"):
        add_stance(other, path)
    with pytest.raises(ValueError, match=r"body\.hash"):
        add_stance(replace(model, body=replace(model.body, v_template=1.01 * model.body.v_template)), path)


def test_the_lowest_stance_is_a_full_one() -> None:
    assert LOWEST == 45.0, "R_stance's code is scaled by it: weights would have to be trained again"
