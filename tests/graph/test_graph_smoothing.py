"""Smoothing by heat flow: analytic decay, a length that is independent of the mesh, borders on their own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse.linalg import expm_multiply

from tests.graph_meshes import disc, tube
from tryon_jax.graph.smoothing import heat_coefficients, make_smoother, smooth, surface_laplacian
from tryon_jax.mesh.topology import border_mask


def apply(vertices, faces, length, values, size=None):
    smoother = make_smoother(vertices, faces, length, size, dtype=np.float64)
    return np.asarray(smooth(smoother, jnp.asarray(values)))


def cylinder(around, along, radius=0.2, length=0.6):
    vertices, faces = tube(around, along, radius, length, shake=0.001)
    vertices[:, [0, 2]] *= (radius / np.linalg.norm(vertices[:, [0, 2]], axis=1))[:, None]
    return vertices, faces


@pytest.mark.parametrize("resolution", [(40, 36), (80, 70)])
def test_a_wave_round_a_tube_decays_as_the_heat_equation_says(x64, resolution):
    vertices, faces = cylinder(*resolution)
    angle = np.arctan2(vertices[:, 2], vertices[:, 0])
    wave = np.cos(3 * angle)
    result = apply(vertices, faces, 0.03, wave)
    inside = np.abs(vertices[:, 1]) < 0.15
    # exp(−length² k² / radius²), the same for any density of the mesh.
    assert (result @ wave / (wave @ wave)) == pytest.approx(np.exp(-(0.03**2) * 9 / 0.04), abs=0.015)
    np.testing.assert_allclose(result[inside], np.exp(-(0.03**2) * 9 / 0.04) * wave[inside], atol=0.03)


def test_equals_the_matrix_exponential(x64):
    vertices, faces = disc(150)
    laplacian, bound = surface_laplacian(vertices, faces)
    values = np.linalg.eigvals(laplacian.toarray())
    assert np.abs(values.imag).max() < 1e-6 * bound
    assert values.real.min() > -1e-6 * bound
    assert values.real.max() <= bound
    x = np.random.default_rng(0).normal(size=(150, 3))
    expected = expm_multiply(-(0.05**2) * laplacian, x)
    np.testing.assert_allclose(apply(vertices, faces, 0.05, x), expected, atol=2e-4)


def test_constants_and_zero_length_change_nothing(x64):
    vertices, faces = disc(100)
    np.testing.assert_allclose(apply(vertices, faces, 0.1, np.ones((100, 2))), 1.0, atol=1e-5)
    np.testing.assert_allclose(apply(vertices, faces, 0.0, vertices), vertices, atol=1e-6)


def test_border_only_knows_the_border(x64):
    vertices, faces = cylinder(24, 20)
    border = border_mask(faces, len(vertices))
    x = np.random.default_rng(0).normal(size=len(vertices))
    y = np.where(border, x, 7.0)
    np.testing.assert_allclose(apply(vertices, faces, 0.04, x)[border], apply(vertices, faces, 0.04, y)[border])


def test_padding_does_not_matter_and_gives_zero(x64):
    vertices, faces = disc(90)
    x = np.zeros((128, 3))
    x[:90] = vertices
    padded = apply(vertices, faces, 0.05, x, size=128)
    np.testing.assert_allclose(padded[:90], apply(vertices, faces, 0.05, vertices), atol=1e-12)
    assert not padded[90:].any()


def test_coefficients_reach_the_exponential_for_stiff_meshes():
    for time, bound in ((1e-4, 1.0), (4e-4, 3e4), (4e-4, 5e5)):
        coefficients = heat_coefficients(time, bound)
        x = np.linspace(-1, 1, 101)
        value = np.polynomial.chebyshev.chebval(x, coefficients)
        np.testing.assert_allclose(value, np.exp(-0.5 * time * bound * (1 + x)), atol=2e-5)
        assert len(coefficients) & (len(coefficients) - 1) == 0


def test_is_linear_and_differentiable(x64):
    vertices, faces = disc(60)
    smoother = make_smoother(vertices, faces, 0.05, dtype=np.float64)
    x = jnp.asarray(vertices)
    value, pull = jax.vjp(lambda x: smooth(smoother, x), x)
    y = jnp.asarray(np.random.default_rng(0).normal(size=x.shape))
    tangent = jax.jvp(lambda x: smooth(smoother, x), (x,), (y,))[1]
    assert float((tangent * value).sum()) == pytest.approx(float((pull(value)[0] * y).sum()))
    np.testing.assert_allclose(tangent, smooth(smoother, y), atol=1e-12)


def test_maps_over_garments_and_their_gradients(x64):
    meshes = [disc(60), disc(75)]
    smoothers = [make_smoother(vertices, faces, 0.05, 80, dtype=np.float64) for vertices, faces in meshes]
    stacked = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *smoothers)
    values = jnp.asarray(np.random.default_rng(1).normal(size=(2, 80, 3)))

    def energy(smoother, x):
        return (smooth(smoother, x) ** 2).sum()

    together = jax.vmap(jax.grad(energy, argnums=1))(stacked, values)
    for smoother, x, found in zip(smoothers, values, together, strict=True):
        np.testing.assert_allclose(found, jax.grad(energy, argnums=1)(smoother, x), atol=1e-12)
