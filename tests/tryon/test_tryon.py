"""Prepare and drape: stages, derivatives, buckets without compilation, stores, bad input."""

import dataclasses
import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from tryon_jax.body import load_body, shape_body
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.garment import build_template, load_design_space, placement, remesh
from tryon_jax.graph.resample import split_long_edges
from tryon_jax.nets import TryOnConfig, UNetConfig, apply_mean_drape
from tryon_jax.tryon import (
    DrapeStages,
    body_contact,
    drape,
    drape_stages,
    init_model,
    load_model,
    mean_drape,
    move_with_graph,
    prepare,
    report_penetration,
    save_model,
    stack_garments,
)

TINY = TryOnConfig(
    smooth=UNetConfig(widths=(4, 6), encoder_convs=1, activation="tanh"),
    fine=UNetConfig(widths=(4,), encoder_convs=1, activation="tanh"),
    fabrics=("gray-interlock", "white-dots-on-blk"),
    num_levels=2,
    # Few vertices: the tests are about the method, not about quality.
    target_area=2e-3,
)


# Compiled once for each shape: op by op, JAX compiles every operation by itself, which takes far longer.
draped = jax.jit(drape, static_argnames="fabric")
draped_stages = jax.jit(drape_stages, static_argnames="fabric")
measured = jax.jit(report_penetration)


@pytest.fixture(scope="module")
def model():
    space = load_design_space()
    center = placement(build_template(space, space.mean_design))
    made = init_model(jax.random.key(0), TINY, template_center=center.astype(np.float32))
    # The heads start small; larger ones make derivatives visible.
    return dataclasses.replace(made, mean=dataclasses.replace(made.mean, template_scale=jnp.asarray(0.02)))


@pytest.fixture(scope="module")
def garment(model):
    return prepare(model, {"sleeve_length": 0.2})


def test_stages_have_the_methods_shape_and_padding_is_zero(model, garment):
    betas = jnp.array([[0.5, -1.0], [0.0, 0.0], [2.0, 1.0]])
    stages = draped_stages(model, garment, betas, fabric="gray-interlock", contact=body_contact(model.body))
    assert isinstance(stages, DrapeStages)
    np.testing.assert_allclose(
        stages.penetration.distance,
        measured(
            body_contact(model.body), model.body, stages.fine, betas, garment.body_vertices, garment.mask
        ).distance,
        atol=1e-6,
    )
    assert stages.fine.shape == stages.smooth.shape == (3, garment.graph.num_nodes, 3)
    np.testing.assert_array_equal(stages.mean, garment.graph.vertices)
    real = garment.num_vertices
    assert not np.asarray(stages.fine[:, real:]).any()
    assert garment.unpad(stages.fine).shape == (3, real, 3)
    assert np.isfinite(stages.fine).all()
    # One body shape at a time gives the same.
    np.testing.assert_allclose(draped(model, garment, betas[2]), stages.fine[2], atol=1e-6)
    # Zero betas alone do not decide; neither do betas not matter.
    assert np.abs(stages.fine[0] - stages.fine[2]).max() > 1e-6


def test_penetration_report_against_exact_distances(model, garment):
    betas = jnp.array([[0.5, -1.0], [0.0, 0.0], [2.0, 1.0]])
    vertices = jnp.broadcast_to(jnp.asarray(garment.graph.vertices), (3, garment.graph.num_nodes, 3))
    places = garment.body_vertices, garment.mask
    report, real = measured(body_contact(model.body), model.body, vertices, betas, *places), garment.num_vertices
    assert report.distance.shape == (3, garment.graph.num_nodes)
    assert not np.asarray(report.distance[:, real:]).any()
    for k, shape in enumerate(betas):
        distance = np.asarray(report.distance[k, :real])
        skin = ClosedSurface(np.asarray(shape_body(model.body, shape)[0]), np.asarray(model.body.faces))
        exact = skin.closest(garment.mean_vertices.astype(float)).distance
        near = np.abs(exact) < 0.02
        assert near.sum() > 40
        assert (np.abs(distance - exact)[near] < 2e-5).mean() > 0.97
        assert (np.abs(distance) > np.abs(exact) - 2e-5)[near].all()
        np.testing.assert_array_equal(np.sign(distance[near]), np.sign(exact[near]))
        assert report.inside[k] == pytest.approx((distance < 0).mean())
        assert report.inside[k] == pytest.approx((exact < 0).mean(), abs=0.01)
        assert report.deepest[k] == pytest.approx(-distance.min())
        assert report.unsettled[k] < 0.02


def test_mean_drape_is_w_times_r_mean(model, garment):
    space = load_design_space()
    design = space.design(sleeve_length=0.2)
    mesh = remesh(space, design, TINY.target_area)
    template = np.asarray(apply_mean_drape(model.mean, jnp.asarray(design.values, jnp.float32)))
    expected = np.einsum("vk,vkc->vc", mesh.template_weights, template[mesh.template_vertices])
    np.testing.assert_allclose(garment.mean_vertices, expected, atol=1e-6)
    np.testing.assert_array_equal(garment.faces, mesh.faces)
    np.testing.assert_allclose(
        mean_drape(model, garment, jnp.asarray(garment.design)), garment.graph.vertices, atol=1e-6
    )


def test_untrained_heads_leave_the_mean_drape_where_it_is(model, garment):
    still = jax.tree.map(jnp.zeros_like, model.smooth.scale)
    for reference in ("smoothed", "paper"):
        changed = dataclasses.replace(
            model,
            smooth=dataclasses.replace(model.smooth, scale=still),
            fine={k: dataclasses.replace(v, scale=still) for k, v in model.fine.items()},
            skin=None,
            config=dataclasses.replace(TINY, reference=reference),
        )
        stages = draped_stages(changed, garment, jnp.ones(2))
        np.testing.assert_allclose(stages.fine, stages.mean, atol=1e-6)
        moved = np.abs(np.asarray(stages.smooth - stages.mean)).max()
        assert (moved > 1e-3) if reference == "smoothed" else (moved < 1e-7)


def test_fabrics_differ(model, garment):
    first, second = (draped(model, garment, jnp.ones(2), fabric=f) for f in TINY.fabrics)
    assert np.abs(np.asarray(first - second)).max() > 1e-5


@pytest.mark.slow
def test_derivatives_against_finite_differences(x64, model, garment):
    def double(tree):
        return jax.tree.map(lambda a: np.asarray(a, np.float64) if np.asarray(a).dtype == np.float32 else a, tree)

    garment, corrected = double(garment), double(model)
    # Corrections of single bodies have thresholds, which a difference may cross.
    model = dataclasses.replace(corrected, skin=None)
    probe = jnp.asarray(np.random.default_rng(0).normal(size=(garment.graph.num_nodes, 3)))
    gradients = jax.grad(lambda b, d: (drape(corrected, garment, b, design=d) * probe).sum(), argnums=(0, 1))(
        jnp.array([0.5, -1.0]), jnp.asarray(garment.design)
    )
    assert all(np.isfinite(g).all() and np.asarray(g).any() for g in gradients)

    @jax.jit
    def by_betas_and_design(betas, design):
        return (drape(model, garment, jnp.asarray(betas), design=jnp.asarray(design)) * probe).sum()

    check_grads(by_betas_and_design, (jnp.array([0.5, -1.0]), jnp.asarray(garment.design)), order=1, rtol=1e-4)

    @jax.jit
    def by_vertices(vertices):
        return (drape(model, garment.with_vertices(jnp.asarray(vertices)), jnp.ones(2)) * probe).sum()

    check_grads(by_vertices, (jnp.asarray(garment.graph.vertices),), order=1, rtol=1e-4)


def test_gradient_reaches_every_weight(model, garment):
    def loss(parts):
        changed = dataclasses.replace(model, smooth=parts[0], fine=model.fine | {"gray-interlock": parts[1]})
        return (drape(changed, garment, jnp.ones(2)) ** 2).sum()

    gradient = jax.jit(jax.grad(loss))((model.smooth, model.fine["gray-interlock"]))
    assert all(np.asarray(leaf).any() for leaf in jax.tree.leaves(gradient))


def test_vmap_over_betas_and_over_garments(model, garment):
    other = prepare(model, {"sleeve_length": 0.25}, seed=1, bucket=garment.graph.num_nodes)
    betas = jnp.array([[0.5, -1.0], [1.0, 2.0]])
    over_betas = jax.jit(jax.vmap(drape, in_axes=(None, None, 0)))(model, garment, betas)
    np.testing.assert_allclose(over_betas, draped(model, garment, betas), atol=1e-6)
    stacked = stack_garments([garment, other])
    over_garments = jax.jit(jax.vmap(drape, in_axes=(None, 0, None)))(model, stacked, betas[0])
    np.testing.assert_allclose(over_garments[0], draped(model, garment, betas[0]), atol=1e-6)
    np.testing.assert_allclose(over_garments[1], draped(model, other, betas[0]), atol=1e-6)


class Compilations(logging.Handler):
    """Counts what XLA compiles, from JAX's own log."""

    def __init__(self):
        super().__init__()
        self.names = []

    def emit(self, record):
        if record.getMessage().startswith("Finished XLA compilation"):
            self.names.append(record.getMessage())


def test_new_topology_in_a_known_bucket_compiles_nothing(model, garment):
    compiled = jax.jit(drape, static_argnames="fabric")
    betas = np.array([0.5, -1.0], np.float32)
    compiled(model, garment, betas, fabric="gray-interlock").block_until_ready()
    size = garment.graph.num_nodes
    others = [prepare(model, {"sleeve_length": s}, seed=i, bucket=size) for i, s in enumerate((0.1, 0.3))]
    assert len({o.num_vertices for o in [garment, *others]}) > 1
    counter, logger = Compilations(), logging.getLogger("jax._src.dispatch")
    level = logger.level
    logger.addHandler(counter)
    logger.setLevel(logging.DEBUG)
    try:
        for other in others:
            compiled(model, other, 2 * betas, fabric="gray-interlock").block_until_ready()
        assert counter.names == []
        jax.jit(lambda x: x * 3.21)(betas).block_until_ready()
        assert len(counter.names) == 1
    finally:
        logger.removeHandler(counter)
        logger.setLevel(level)


def test_same_result_in_a_larger_bucket(model, garment):
    larger = prepare(model, {"sleeve_length": 0.2}, bucket=2 * garment.graph.num_nodes)
    betas = jnp.array([0.5, -1.0])
    first, second = draped(model, garment, betas), draped(model, larger, betas)
    np.testing.assert_allclose(larger.unpad(second), garment.unpad(first), atol=1e-6)


def test_store_round_trip_and_mismatches(model, tmp_path):
    path = tmp_path / "model.safetensors"
    save_model(path, model, {"steps": 3})
    again = load_model(path)
    assert again.config == model.config
    for a, b in zip(jax.tree.leaves(model), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    other = dataclasses.replace(load_body(), v_template=np.asarray(load_body().v_template) * 1.01, name="larger")
    with pytest.raises(ValueError, match="body") as refusal:
        load_model(path, body=other)
    assert "body.hash" in str(refusal.value)
    assert "body.name" in str(refusal.value)


def test_bad_input_is_named(model, garment):
    with pytest.raises(ValueError, match="did you mean 'gray-interlock'"):
        drape(model, garment, jnp.ones(2), fabric="grey-interlock")
    with pytest.raises(ValueError, match="betas must be 2 numbers"):
        drape(model, garment, jnp.ones(3))
    with pytest.raises(ValueError, match="did you mean 'sleeve_length'"):
        prepare(model, {"sleeve_lenght": 0.2})
    with pytest.raises(ValueError, match="outside its range"):
        prepare(model, {"sleeve_length": 20.0})
    with pytest.raises(ValueError, match="different buckets"):
        stack_garments([garment, prepare(model, bucket=2 * garment.graph.num_nodes)])


def test_own_mesh_of_known_density_is_used_as_it_is(model, garment):
    vertices, faces = garment.mean_vertices, garment.faces
    own = prepare(model, mesh=(vertices, faces), bucket=garment.graph.num_nodes)
    assert own.own is None
    np.testing.assert_array_equal(own.faces, faces)
    # The same graph but for the hierarchy, which a design's flat pattern makes.
    for mine, theirs in zip(
        jax.tree.leaves(own.graph.levels[0].laplacian), jax.tree.leaves(garment.graph.levels[0].laplacian), strict=True
    ):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(own.graph.skinning_weights, garment.graph.skinning_weights)
    with pytest.raises(ValueError, match="mesh without a design"):
        drape(model, own, jnp.array([0.5, -1.0]), design=jnp.asarray(garment.design))


def test_own_mesh_of_another_density_is_carried_by_an_even_copy(model, garment):
    fine, fine_faces = split_long_edges(garment.mean_vertices.astype(float), garment.faces, 0.02)
    own = prepare(model, mesh=(fine, fine_faces))
    assert own.num_vertices == len(fine)
    # The copy is about as coarse as the networks know.
    assert 0.7 < int(own.graph.num_vertices) / garment.num_vertices < 1.4
    np.testing.assert_array_equal(own.faces, fine_faces)
    stages = draped_stages(model, own, jnp.ones((2, 2)))
    assert own.unpad(stages.fine).shape == (2, len(fine), 3)
    np.testing.assert_allclose(own.unpad(stages.mean), fine, atol=1e-6)
    # Own vertices move as the surface around them does.
    shift = np.zeros((own.graph.num_nodes, 3), np.float32)
    shift[: int(own.graph.num_vertices)] = (0.1, 0.2, 0.3)
    mean = jnp.asarray(own.graph.vertices)
    np.testing.assert_allclose(
        own.unpad(move_with_graph(own, mean + shift, mean)) - fine, [[0.1, 0.2, 0.3]] * len(fine), atol=1e-5
    )


def test_own_mesh_in_millimetres_is_scaled_and_one_elsewhere_is_refused(model, garment):
    vertices, faces = garment.mean_vertices.astype(float), garment.faces
    scaled = prepare(model, mesh=(1000 * vertices, faces))
    np.testing.assert_allclose(scaled.mean_vertices, vertices, atol=1e-5)
    with pytest.raises(ValueError, match="not on the mean body"):
        prepare(model, mesh=(vertices + np.array([0.0, 3.0, 0.0]), faces))
    with pytest.raises(ValueError, match="not both"):
        prepare(model, "tshirt", mesh=(vertices, faces))
    with pytest.raises(ValueError, match="finite"):
        prepare(model, mesh=(vertices * np.nan, faces))
    with pytest.raises(FileNotFoundError, match=r"gone\.obj"):
        prepare(model, mesh="gone.obj")
