"""The template that a drape comes from is found again."""

import numpy as np

from tryon_jax.training.template_fit import fit_template


def test_an_interpolated_template_is_found() -> None:
    rng = np.random.default_rng(0)
    template = rng.normal(size=(6, 3))
    corners = np.array([rng.permutation(6)[:3] for _ in range(400)])
    weights = rng.dirichlet(np.ones(3), size=400)
    drape = np.einsum("vk,vkc->vc", weights, template[corners])
    found = fit_template(corners, weights, drape)
    # The pull towards local averages is weak where many vertices see a place.
    assert np.abs(found - template).max() < 0.01
    np.testing.assert_allclose(fit_template(corners, weights, drape + 1.0), found + 1.0, atol=1e-9)


def test_a_place_that_no_vertex_pins_down_follows_its_neighbours() -> None:
    corners, weights = np.array([[0, 1, 2], [0, 1, 2]]), np.array([[0.5, 0.5, 0.0], [0.5, 0.4, 0.1]])
    found = fit_template(corners, weights, np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(found, np.broadcast_to([1.0, 0.0, 0.0], (3, 3)), atol=1e-9)
