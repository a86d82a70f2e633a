"""Drapes of designs that start from kriged ones; meshes without a design, and other fabrics, start from M_smooth."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from tests.tryon.test_drape_fields import make_model
from tests.tryon.test_tryon import TINY
from tryon_jax.nets.kernel_factor import with_factors
from tryon_jax.nets.kriging import (
    KernelFunctions,
    Kriging,
    KrigingConfig,
    functions_and_trend,
    joint_functions,
)
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.physics.fabric_numbers import fabric_numbers
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.node_drapes import NodeReader
from tryon_jax.tryon import (
    ALL_FABRICS,
    Garment,
    TryOnModel,
    apply_fields,
    drape,
    drape_fields,
    drape_stages,
    init_model,
    load_model,
    prepare,
    save_model,
    stages_of,
)
from tryon_jax.tryon.shared_fine import add_shared_fine, save_shared_fine

KNIT, WOVEN, OTHER = "gray-interlock", "white-dots-on-blk", "royal-target"
CONFIG = replace(
    TINY,
    kriging=KrigingConfig(designs=6, shapes=5, functions=20, components=4),
    kriged_fine=UNetConfig(widths=(5,), encoder_convs=1, activation="tanh"),
    shared_fabrics=(KNIT, WOVEN, OTHER),
    fabric_functions=2,
)
BETAS = jnp.array([[0.5, -1.0], [1.0, 2.0], [0.0, 0.0]])
draped = jax.jit(drape, static_argnames="fabric")


def random_drapes(model: TryOnModel, kriging: Kriging, seed: int) -> Kriging:
    """Displacements of centimetres; those of padded nodes too."""
    rng = np.random.default_rng(seed)
    arrays = {name: rng.normal(size=getattr(kriging, name).shape) for name in ("mean", "components", "weights")}
    half = 0.5 * np.array([0.5, 0.5, 0.5])
    centres = [jnp.asarray(rng.uniform(-1, 1, np.shape(f.centres)), jnp.float32) for f in _kernels(kriging)]
    designs, shapes = (replace(f, centres=c) for f, c in zip(_kernels(kriging), centres, strict=True))
    made = replace(
        kriging,
        designs=designs,
        shapes=replace(kriging.shapes, kernel=shapes),
        of_design=jnp.asarray(rng.integers(np.shape(designs.centres)[0] + 4, size=len(kriging.of_design))),
        of_shape=jnp.asarray(rng.integers(np.shape(shapes.centres)[0] + 3, size=len(kriging.of_shape))),
        edges=jnp.asarray(NodeReader(model).edges),
        design_center=jnp.array([0.2, 1.1, 0.7]),
        design_scale=jnp.asarray(half, jnp.float32),
        **{name: jnp.asarray(0.1 * array, jnp.float32) for name, array in arrays.items()},
    )
    return with_factors(made)


def _kernels(kriging: Kriging) -> tuple[KernelFunctions, KernelFunctions]:
    return kriging.designs, kriging.shapes.kernel


@pytest.fixture(scope="module")
def model() -> TryOnModel:
    made = make_model(CONFIG)
    return replace(made, kriging={f: random_drapes(made, k, i) for i, (f, k) in enumerate(made.kriging.items())})


@pytest.fixture(scope="module")
def garment(model: TryOnModel) -> Garment:
    return prepare(model, {"sleeve_length": 0.2})


def test_a_design_starts_from_its_kriged_drape(model: TryOnModel, garment: Garment) -> None:
    model = replace(model, skin=None)
    assert stages_of(model, garment, KNIT) == (model.kriging[KNIT], model.fine[KNIT])
    assert stages_of(model, garment, None)[0] is model.kriging[KNIT]
    still = replace(model.kriging[KNIT], mean=jnp.zeros_like(model.kriging[KNIT].mean))
    without = replace(model, kriging=model.kriging | {KNIT: replace(still, weights=jnp.zeros_like(still.weights))})
    moved = draped(model, garment, BETAS, fabric=KNIT) - draped(without, garment, BETAS, fabric=KNIT)
    assert np.abs(garment.unpad(moved)).max() > 0.01
    # What is added is the process, whatever R_fine adds; its fields are read at the vertices of the mesh.
    kriging = model.kriging[KNIT]
    scaled = (np.asarray(garment.design) - np.asarray(kriging.design_center)) / np.asarray(kriging.design_scale)
    shapes = BETAS / kriging.shapes.shape_scale[None]
    of_designs = functions_and_trend(kriging.designs, jnp.asarray(np.tile(scaled, (3, 1)), jnp.float32))
    of_shapes = functions_and_trend(kriging.shapes.kernel, shapes)
    values = joint_functions(of_designs, of_shapes, (kriging.of_design, kriging.of_shape))
    fields = np.einsum("sf,fr,rqc->sqc", values, kriging.weights, kriging.components) + np.asarray(kriging.mean)
    operator = NodeReader(model).operator(garment)
    np.testing.assert_allclose(garment.unpad(moved), np.stack([operator @ field for field in fields]), atol=1e-4)
    assert not np.asarray(moved[:, garment.num_vertices :]).any()


def test_fields_and_stages_agree(model: TryOnModel, garment: Garment) -> None:
    fields = jax.jit(drape_fields, static_argnames="fabric")(model, garment, fabric=WOVEN)
    np.testing.assert_allclose(apply_fields(fields, BETAS), draped(model, garment, BETAS, fabric=WOVEN), atol=2e-6)
    stages = drape_stages(model, garment, BETAS, WOVEN)
    np.testing.assert_allclose(stages.fine, draped(model, garment, BETAS, fabric=WOVEN), atol=2e-6)
    mapped = jax.vmap(lambda betas: drape(model, garment, betas, WOVEN))(BETAS)
    np.testing.assert_allclose(mapped, stages.fine, atol=2e-6)


def test_other_fabrics_start_from_m_smooth(model: TryOnModel, garment: Garment) -> None:
    assert stages_of(model, garment, OTHER)[0] is model.smooth
    numbers = fabric_numbers(load_fabric(KNIT))
    assert stages_of(model, garment, numbers)[0] is model.smooth


def test_a_mesh_without_a_design_starts_from_m_smooth(model: TryOnModel, garment: Garment) -> None:
    bare = prepare(model, mesh=(garment.mean_vertices, garment.faces))
    first, second = stages_of(model, bare, KNIT)
    assert first is model.smooth
    assert second.net is model.fine[ALL_FABRICS].net
    assert np.isfinite(draped(model, bare, BETAS, fabric=KNIT)).all()
    alone = replace(model, config=replace(model.config, shared_fabrics=()))
    with pytest.raises(ValueError, match="drapes only designs in 'gray-interlock'"):
        drape(alone, bare, BETAS, KNIT)


def test_a_finer_mesh_moves_with_the_one_that_is_draped(model: TryOnModel, garment: Garment) -> None:
    fine = prepare(model, {"sleeve_length": 0.2}, target_area=TINY.target_area / 4)
    assert fine.own is not None
    found = fine.unpad(draped(model, fine, BETAS, fabric=KNIT))
    even = garment.unpad(draped(model, garment, BETAS, fabric=KNIT))
    np.testing.assert_allclose(found.mean(axis=1), even.mean(axis=1), atol=0.01)


def test_it_is_differentiable_in_betas_and_design(model: TryOnModel, garment: Garment) -> None:
    weight = jax.random.normal(jax.random.key(3), (garment.graph.num_nodes, 3))
    model = replace(model, skin=None)

    @jax.jit
    def value(betas: jax.Array, design: jax.Array) -> jax.Array:
        return (drape(model, garment, jnp.asarray(betas), KNIT, jnp.asarray(design)) * weight).sum()

    design = jnp.asarray(garment.design)
    check_grads(value, (BETAS[0], design), order=1, modes=["rev"], eps=2e-3, rtol=5e-2)
    assert np.abs(np.asarray(jax.grad(value, 1)(BETAS[0], design))).min() > 1e-3


def test_files_keep_kriged_drapes(model: TryOnModel, garment: Garment, tmp_path: Path) -> None:
    alone = replace(model, fine={f: model.fine[f] for f in (KNIT, WOVEN)}, config=replace(CONFIG, shared_fabrics=()))
    for half, tolerance in ((False, 1e-6), (True, 1e-3)):
        save_model(tmp_path / "model.safetensors", alone, half=half)
        again = load_model(tmp_path / "model.safetensors")
        assert again.config == alone.config
        found = draped(again, garment, BETAS, fabric=WOVEN)
        np.testing.assert_allclose(found, draped(alone, garment, BETAS, fabric=WOVEN), atol=tolerance)


def test_an_r_fine_of_all_fabrics_is_added_to_kriged_drapes(model: TryOnModel, tmp_path: Path) -> None:
    # Trained beside R_mean and R_smooth, it knows nothing of kriging.
    config = replace(CONFIG, fabrics=(), kriging=None)
    made = replace(init_model(jax.random.key(5), config), mean=model.mean, smooth=model.smooth)
    save_shared_fine(tmp_path / "shared.safetensors", made)
    alone = replace(model, fine={f: model.fine[f] for f in (KNIT, WOVEN)}, config=replace(CONFIG, shared_fabrics=()))
    both = add_shared_fine(alone, tmp_path / "shared.safetensors")
    assert set(both.fine) == {KNIT, WOVEN, ALL_FABRICS}
    assert both.config == CONFIG


def test_the_papers_form_has_no_kriged_drapes() -> None:
    with pytest.raises(ValueError, match='kriged drapes need conditioning="fields", not "node"'):
        init_model(jax.random.key(0), replace(CONFIG, shared_fabrics=(), conditioning="node"))
