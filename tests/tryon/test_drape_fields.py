"""Drape fields: their sum is the drape, in every form that users and training ask for it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from benchmarks._machine import counting_compilations
from tests.tryon.test_tryon import TINY
from tryon_jax.contact.skin import Skin
from tryon_jax.garment import build_template, load_design_space, placement
from tryon_jax.graph.resample import split_long_edges
from tryon_jax.nets import apply_mlp, paper_form
from tryon_jax.training.stage_prediction import predict
from tryon_jax.tryon import (
    Garment,
    TryOnModel,
    apply_fields,
    drape,
    drape_fields,
    init_model,
    load_pretrained,
    prepare,
    smooth_features,
)
from tryon_jax.tryon.mean_drape import with_design

BETAS = jnp.array([[0.5, -1.0], [1.0, 2.0], [0.0, 0.0]])
draped = jax.jit(drape, static_argnames="fabric")
made = jax.jit(drape_fields, static_argnames="fabric")
applied = jax.jit(apply_fields)


def make_model(config=TINY) -> TryOnModel:
    space = load_design_space()
    center = placement(build_template(space, space.mean_design))
    model = init_model(jax.random.key(0), config, template_center=center.astype(np.float32))
    return dataclasses.replace(model, mean=dataclasses.replace(model.mean, template_scale=jnp.asarray(0.02)))


@pytest.fixture(scope="module")
def model() -> TryOnModel:
    return make_model()


@pytest.fixture(scope="module")
def garment(model: TryOnModel) -> Garment:
    return prepare(model, {"sleeve_length": 0.2})


def test_the_fields_weighted_by_the_coefficients_are_the_drape(model: TryOnModel, garment: Garment) -> None:
    model = dataclasses.replace(model, skin=None)
    fields = made(model, garment, fabric="white-dots-on-blk")
    total = np.zeros((len(BETAS), garment.graph.num_nodes, 3))
    for part in (fields.smooth, fields.fine):
        periods = model.config.beta_periods
        waves = [w(2 * np.pi * BETAS / period) for w in (np.sin, np.cos) for period in periods]
        weights = np.asarray(apply_mlp(part.coefficients, jnp.concatenate([BETAS / 2.0, *waves], axis=-1)))
        total += np.asarray(part.offset)[None] + np.einsum("nck,bk->bnc", part.fields, weights)
    found = draped(model, garment, BETAS, fabric="white-dots-on-blk")
    np.testing.assert_allclose(found, total, atol=1e-6)
    assert np.abs(found[0] - found[1]).max() > 1e-4


def test_applying_fields_is_draping_for_any_batch_of_bodies(model: TryOnModel, garment: Garment) -> None:
    fields = made(model, garment)
    for betas in (BETAS, BETAS[0], BETAS[None, :2]):
        np.testing.assert_allclose(applied(fields, betas), draped(model, garment, betas), atol=1e-6)
    mapped = jax.vmap(apply_fields, (None, 0))(fields, BETAS)
    np.testing.assert_allclose(mapped, applied(fields, BETAS), atol=1e-6)


def test_another_design_at_the_same_topology_has_its_own_fields(model: TryOnModel, garment: Garment) -> None:
    design = jnp.asarray(garment.design) + jnp.array([0.05, 0.02, -0.05])
    fields = drape_fields(model, garment, design=design)
    expected = draped(model, garment, BETAS, design=design)
    np.testing.assert_allclose(apply_fields(fields, BETAS), expected, atol=1e-6)
    assert np.abs(np.asarray(expected) - np.asarray(draped(model, garment, BETAS))).max() > 1e-3


def test_edges_at_rest_grow_with_the_mean_drape(model: TryOnModel, garment: Garment) -> None:
    design = jnp.asarray(garment.design)
    same = with_design(model, garment, design)
    np.testing.assert_allclose(np.asarray(same.rest), np.asarray(garment.rest), rtol=1e-4)
    # A mean drape that is a tenth larger, about the origin: so is the pattern.
    mean = dataclasses.replace(model.mean, template_scale=0.0 * model.mean.template_scale)
    larger = dataclasses.replace(mean, template_center=1.1 * mean.template_center)
    start = with_design(dataclasses.replace(model, mean=mean), garment, design)
    grown = with_design(dataclasses.replace(model, mean=larger), start, design)
    assert garment.edges is not None
    first, second = np.asarray(garment.edges).T
    real = first != second
    np.testing.assert_allclose(np.asarray(grown.rest)[real], 1.1 * np.asarray(start.rest)[real], rtol=1e-3)


def test_fields_of_an_own_mesh_move_its_own_vertices(model: TryOnModel, garment: Garment) -> None:
    fine, faces = split_long_edges(garment.mean_vertices.astype(float), garment.faces, 0.02)
    own = prepare(model, mesh=(fine, faces))
    assert own.own is not None
    found = apply_fields(drape_fields(model, own), BETAS)
    np.testing.assert_allclose(own.unpad(found), own.unpad(draped(model, own, BETAS)), atol=1e-6)


def test_padding_changes_nothing(model: TryOnModel, garment: Garment) -> None:
    larger = prepare(model, {"sleeve_length": 0.2}, bucket=2 * garment.graph.num_nodes)
    one, other = made(model, garment), made(model, larger)
    np.testing.assert_allclose(
        larger.unpad(apply_fields(other, BETAS)), garment.unpad(apply_fields(one, BETAS)), atol=1e-6
    )
    assert not np.asarray(other.smooth.fields)[larger.num_vertices :].any()


def test_the_order_of_the_vertices_does_not_matter() -> None:
    net = dataclasses.replace(TINY.smooth, widths=(6,))
    model = make_model(dataclasses.replace(TINY, smooth=net, fine=net, num_levels=1))
    garment = prepare(model, {"sleeve_length": 0.2})
    vertices, faces = garment.mean_vertices, garment.faces
    order = np.random.default_rng(0).permutation(len(vertices))
    number = np.argsort(order)
    first = prepare(model, mesh=(vertices, faces))
    second = prepare(model, mesh=(vertices[order], number[faces]))
    fields = [g.unpad(np.moveaxis(np.asarray(drape_fields(model, g).smooth.fields), 2, 0)) for g in (first, second)]
    np.testing.assert_allclose(fields[1], fields[0][:, order], atol=1e-6)


def test_gradients_by_the_body_against_finite_differences(x64, model: TryOnModel, garment: Garment) -> None:
    def double(tree):
        return jax.tree.map(lambda a: np.asarray(a, np.float64) if np.asarray(a).dtype == np.float32 else a, tree)

    fields = drape_fields(double(model), double(garment))
    probe = jnp.asarray(np.random.default_rng(0).normal(size=(garment.graph.num_nodes, 3)))
    check_grads(lambda b: (apply_fields(fields, b) * probe).sum(), (jnp.array([0.5, -1.0]),), order=2, rtol=1e-5)


def test_a_new_topology_of_a_known_bucket_compiles_nothing(model: TryOnModel, garment: Garment) -> None:
    other = prepare(model, {"sleeve_length": 0.25}, seed=3, bucket=garment.graph.num_nodes)
    applied(made(model, garment), BETAS)
    with counting_compilations() as compilations:
        applied(made(model, other), BETAS)
    assert compilations.count == 0


def test_training_predicts_what_users_get(model: TryOnModel, garment: Garment) -> None:
    """The same functions, so the same numbers to the last bit, in both forms."""
    for used in (model, make_model(paper_form(TINY))):
        prepared = garment if used is model else prepare(used, {"sleeve_length": 0.2})
        config, fine = used.config, used.fine["gray-interlock"]
        nothing = jnp.zeros((len(BETAS), 1, 3))
        smooth = predict(config, "smooth", used.smooth, prepared, BETAS, nothing)
        found = predict(config, "fine", fine, prepared, BETAS, smooth)
        raw = dataclasses.replace(used, skin=None)
        np.testing.assert_array_equal(found, drape(raw, prepared, BETAS, "gray-interlock"))


def test_drapes_are_kept_clear_of_the_body(model: TryOnModel, garment: Garment) -> None:
    raw = garment.unpad(draped(dataclasses.replace(model, skin=None), garment, BETAS))
    fields = made(model, dataclasses.replace(garment, edges=None, rest=None))
    assert fields.corrections is not None
    assert fields.corrections.pull is None
    padded = applied(fields, BETAS)
    assert not np.asarray(padded)[:, garment.num_vertices :].any()
    for k, betas in enumerate(BETAS):
        skin = Skin.of_shape(model.body, betas)
        # Cloth that is up to a centimetre inside comes out; farther in, the next skin may be that of the other side.
        before, after = (skin.signed_distances(v[k]) for v in (raw, garment.unpad(padded)))
        shallow = (before < 0) & (before > -0.01)
        assert shallow.sum() > 5
        assert (after[shallow] > 0).mean() > 0.9
        clear = before > 0.02
        np.testing.assert_allclose(garment.unpad(padded)[k][clear], raw[k][clear], atol=1e-6)


def test_a_model_in_the_papers_form_has_no_fields_and_still_drapes() -> None:
    model = load_pretrained("paper-form")
    assert model.config.conditioning == "node"
    mesh_model = make_model()
    garment = prepare(model, "tshirt", target_area=8e-4)
    with pytest.raises(ValueError, match='conditioning="node"'):
        drape_fields(model, garment)
    away = np.linalg.norm(garment.unpad(draped(model, garment, BETAS[0])) - garment.mean_vertices, axis=1)
    assert 1e-3 < away.mean() < 0.1
    assert mesh_model.config.conditioning == "fields"
    with pytest.raises(ValueError, match="linen"):
        drape_fields(mesh_model, garment, fabric="linen")


def test_places_on_the_pattern_are_features_that_a_bare_mesh_lacks(garment: Garment) -> None:
    config = dataclasses.replace(TINY, pattern_features=True)
    bare = dataclasses.replace(garment, design=None, template_vertices=None, template_weights=None)
    plain, found, without = (
        smooth_features(c, g)[:, 0] for c, g in ((TINY, garment), (config, garment), (config, bare))
    )
    assert found.shape[1] == config.smooth_features == TINY.smooth_features + 3 + 4 * len(config.wavelengths)
    places = np.asarray(found[:, plain.shape[1] :])
    np.testing.assert_array_equal(found[:, : plain.shape[1]], plain)
    np.testing.assert_array_equal(without[:, plain.shape[1] :], 0.0)
    np.testing.assert_array_equal(places[garment.num_vertices :], 0.0)
    side = places[: garment.num_vertices, 2]
    assert {-1.0, 0.0, 1.0} <= set(np.round(side, 3).tolist())
    # The front of a garment is before its back, and v grows upwards.
    depth, height = garment.mean_vertices[:, 2], garment.mean_vertices[:, 1]
    assert depth[side > 0.5].mean() > depth[side < -0.5].mean() + 0.05
    assert np.corrcoef(places[: garment.num_vertices, 1], height)[0, 1] > 0.9
    model = make_model(config)
    assert np.isfinite(np.asarray(draped(model, garment, BETAS))).all()
    assert np.isfinite(np.asarray(draped(model, bare, BETAS))).all()


def test_a_bare_mesh_is_told_no_design(model: TryOnModel, garment: Garment) -> None:
    middle = load_design_space().middle.astype(np.float32)
    bare = dataclasses.replace(garment, design=None)
    same = dataclasses.replace(garment, design=middle)
    np.testing.assert_allclose(draped(model, bare, BETAS), draped(model, same, BETAS), atol=1e-6)
