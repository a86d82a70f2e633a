"""The kNN: the closest vertices among those of garments that know a shape, as a search among these alone finds them."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from experiments.shared.neighbours import DESIGN_SCALE, NEIGHBOURS, REACH, Drapes, NearestGarments
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.training.protocol import EXTENT

MANIFEST = load_manifest()
HALF = 0.5 * (MANIFEST.space.maximum - MANIFEST.space.minimum)


def garment(label: str, rng: np.random.Generator) -> Drapes:
    """Random vertices, each moved at random on one random body: there is nothing to interpolate."""
    mean = 0.3 * rng.normal(size=(150, 3)).astype(np.float32)
    betas = rng.uniform(-1.5, 1.5, (1, 2)).astype(np.float32)
    vertices = mean + 0.01 * rng.normal(size=(1, 150, 3)).astype(np.float32)
    good, ties = np.ones(1, bool), (np.zeros((150, 3), int), np.ones((150, 3)) / 3)
    return Drapes(f"{label}-0", mean, MANIFEST.design(label).values, betas, vertices, good, ~good, *ties)


@pytest.mark.parametrize("with_design", [False, True])
def test_the_neighbours_are_those_of_garments_that_know_the_shape(with_design):
    rng = np.random.default_rng(0)
    garments = [garment(design.label, rng) for design in MANIFEST.additional[:40]]
    betas = rng.uniform(-1.5, 1.5, (5, 2)).astype(np.float32)
    mean, design = 0.3 * rng.normal(size=(60, 3)).astype(np.float32), MANIFEST.unseen[0].values
    samples = SimpleNamespace(garment=SimpleNamespace(mean_vertices=mean, design=design), betas=betas)
    found = NearestGarments(garments, MANIFEST, betas)(samples, np.arange(5), with_design)

    def key(vertices: np.ndarray, of: np.ndarray) -> np.ndarray:
        scaled = np.broadcast_to(DESIGN_SCALE * (of - MANIFEST.space.mean) / HALF, (len(vertices), 3))
        return np.concatenate([vertices, scaled], axis=1) if with_design else vertices

    for beta, drape in zip(betas, found, strict=True):
        near = [g for g in garments if np.linalg.norm((g.betas[0] - beta) / np.array(EXTENT)) <= REACH]
        assert 0 < len(near) < len(garments)
        moves = np.concatenate([g.vertices[0] - g.mean for g in near])
        distance, index = cKDTree(np.concatenate([key(g.mean, g.design) for g in near])).query(
            key(mean, design), k=NEIGHBOURS
        )
        weights = 1 / (distance**2 + 2e-3**2)
        expected = mean + np.einsum("vk,vkc->vc", weights / weights.sum(axis=1, keepdims=True), moves[index])
        np.testing.assert_allclose(drape, expected, atol=1e-6)
