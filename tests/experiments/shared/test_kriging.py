"""Kriging over designs and body shapes: near a smooth function, honest about splits."""

import numpy as np
import pytest

from experiments.shared.kriging import Kernel, KrigedGarments, blend
from experiments.shared.neighbours import Drapes
from tryon_jax.garment.manifest import load_manifest

MANIFEST = load_manifest()
TEMPLATE = np.random.default_rng(0).uniform(-0.3, 0.3, (60, 3))
HALF = 0.5 * (MANIFEST.space.maximum - MANIFEST.space.minimum)


def moved(design: np.ndarray, betas: np.ndarray) -> np.ndarray:
    """A displacement of all vertices that is smooth in both, metres."""
    scaled = (design - MANIFEST.space.mean) / HALF
    height = 0.02 * np.sin(1.5 * scaled[0]) + 0.01 * betas[:, 0] / 3 + 0.01 * scaled[1] * betas[:, 1] / 2
    return height[:, None, None] * np.array([0.0, 1.0, 0.0])


def garment(label: str, seed: int = 0) -> Drapes:
    """One garment on random shapes, every vertex at one of the template."""
    rng = np.random.default_rng(int(label.split("-")[-1]))
    betas = rng.uniform(-1.5, 1.5, (6, 2)).astype(np.float32)
    design = MANIFEST.design(label).values
    corners = np.repeat(np.arange(len(TEMPLATE))[:, None], 3, axis=1)
    good = np.ones(len(betas), bool)
    weights = np.tile([1.0, 0.0, 0.0], (len(TEMPLATE), 1))
    mean = TEMPLATE.astype(np.float32)
    return Drapes(f"{label}-{seed}", mean, design, betas, mean + moved(design, betas), good, ~good, corners, weights)


def labels(count: int) -> list[str]:
    return [design.label for design in MANIFEST.additional[:count]]


def test_a_smooth_function_is_found_between_the_designs():
    kriged = KrigedGarments([garment(label) for label in labels(60)], MANIFEST, TEMPLATE)
    design, betas = MANIFEST.unseen[1].values, np.array([[0.4, -0.3], [-1.0, 0.8]], np.float32)
    truth = moved(design, betas)
    error = np.abs(kriged.fields(design, betas) - truth).max()
    assert error < 0.1 * np.abs(truth).max()


def test_the_kernel_is_the_one_that_suits_the_validation_designs():
    """Among three of which two are absurd."""
    sound = Kernel(0.8, 1.6, 0.01)
    kernels = (Kernel(1e-3, 1e-3, 0.1), Kernel(0.8, 1.6, 1e6), sound)
    assert KrigedGarments([garment(label) for label in labels(60)], MANIFEST, TEMPLATE, kernels).kernel == sound


def test_nothing_is_learned_from_a_test_garment():
    label = MANIFEST.unseen[0].label
    good = np.ones(1, bool)
    mean, ties = np.zeros((1, 3), np.float32), (np.zeros((1, 3), int), np.ones((1, 3)) / 3)
    test = Drapes(
        f"{label}-0", mean, MANIFEST.unseen[0].values, np.zeros((1, 2), np.float32), mean[None], good, ~good, *ties
    )
    with pytest.raises(PermissionError, match="test garment"):
        KrigedGarments([test], MANIFEST, TEMPLATE)
    with pytest.raises(ValueError, match="at least one"):
        KrigedGarments([], MANIFEST, TEMPLATE)


def test_a_vertex_is_read_where_it_is():
    index, weights = blend(TEMPLATE, TEMPLATE)
    np.testing.assert_array_equal(index[:, 0], np.arange(len(TEMPLATE)))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-6)
    assert weights[:, 0].min() > 0.9
