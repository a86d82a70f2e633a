"""Batches of garments: only those whose arrays have the same shapes are stacked."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tryon_jax.body import load_body
from tryon_jax.garment import load_design_space, placement, remesh
from tryon_jax.nets.config import load_config
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.training.batches import BatchSource
from tryon_jax.training.stage_sets import StageSet
from tryon_jax.tryon import Garment, array_shapes, init_model, prepare_mesh, stack_garments

SHAPES = 5


@pytest.fixture(scope="module")
def garment() -> Garment:
    net = UNetConfig(widths=(4,), encoder_convs=1)
    config = load_config("small-node", smooth=net, fine=net, num_levels=1)
    space = load_design_space()
    mesh = remesh(space, space.preset("tank"), 4e-3)
    return prepare_mesh(init_model(jax.random.key(0), config, body=load_body()), mesh, vertices=placement(mesh))


def longer(garment: Garment) -> Garment:
    """The same with room for more triangles, as a mesh with an unusual vertex has longer tables."""
    faces = np.asarray(garment.graph.faces)
    return replace(garment, graph=replace(garment.graph, faces=np.concatenate([faces, np.zeros_like(faces[:4])])))


def samples(name: str, garment: Garment) -> StageSet:
    size = garment.graph.num_nodes
    train = np.ones(SHAPES, bool)
    return StageSet(
        name, garment, np.zeros((SHAPES, 2), np.float32), None, np.zeros((SHAPES, size, 3), np.float32), train, ~train
    )


def test_every_garment_is_drawn_with_its_like(garment):
    others = [longer(garment), garment, garment]
    source = BatchSource([samples(str(k), g) for k, g in enumerate(others)], garments=2, shapes=3)
    rng = np.random.default_rng(0)
    drawn = [source.draw(rng).garments.graph.faces.shape for _ in range(40)]
    few, many = ((2, *np.shape(g.graph.faces)) for g in (garment, longer(garment)))
    assert {few, many} == set(drawn)
    # In proportion to the garments that there are.
    assert 5 <= drawn.count(many) <= 25


def test_what_cannot_be_stacked_is_named(garment):
    assert array_shapes(garment) != array_shapes(longer(garment))
    with pytest.raises(ValueError, match="tables of neighbours"):
        stack_garments([garment, longer(garment)])


@pytest.mark.parametrize("dropout", [0.0, 1.0])
def test_who_is_not_told_the_design_has_no_place_on_the_pattern(garment, dropout):
    nothing = np.zeros_like(np.asarray(garment.design))
    source = BatchSource([samples("a", garment)], garments=2, shapes=3, no_design=nothing, dropout=dropout)
    drawn = source.draw(np.random.default_rng(0)).garments
    assert np.asarray(drawn.design).any() == (dropout == 0.0)
    assert np.asarray(drawn.template_weights).any() == (dropout == 0.0)
