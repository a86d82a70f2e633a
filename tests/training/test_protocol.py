"""The protocol of body shapes: how many, where, and which may be trained on."""

import numpy as np
import pytest

from tryon_jax.training.protocol import EXTENT, Protocol, make_protocol


def everything(protocol: Protocol) -> tuple[np.ndarray, np.ndarray]:
    """All betas, the mean body first, and whether each is for testing."""
    mean = np.zeros((1, protocol.num_betas))
    return np.concatenate([mean, *protocol.rays]), np.concatenate([[False], *protocol.test])


@pytest.mark.parametrize("num_betas", [1, 2])
def test_the_papers_counts(num_betas: int) -> None:
    betas, test = everything(make_protocol(num_betas))
    assert betas.shape == (201, num_betas)
    assert (~test).sum() == 101
    assert test.sum() == 100


@pytest.mark.parametrize("num_betas", [1, 2])
def test_no_shape_occurs_twice_so_none_leaks(num_betas: int) -> None:
    betas, test = everything(make_protocol(num_betas))
    apart = np.linalg.norm(betas[:, None] - betas[None], axis=2)
    assert apart[~np.eye(201, dtype=bool)].min() > 0.01
    assert apart[np.ix_(test, ~test)].min() > 0.01


def test_one_beta_is_the_papers_uniform_sweep() -> None:
    betas, test = everything(make_protocol(1))
    order = np.argsort(betas[:, 0])
    np.testing.assert_allclose(np.diff(betas[order, 0]), 0.03, atol=1e-12)
    assert (betas.min(), betas.max()) == (-3.0, 3.0)
    # Training and test shapes alternate, with training shapes at both ends.
    np.testing.assert_array_equal(test[order], np.arange(201) % 2 == 1)


def test_rays_run_outwards_and_straight() -> None:
    for num_betas in (1, 2):
        for ray in make_protocol(num_betas).rays:
            radius = np.linalg.norm(ray, axis=1)
            assert (np.diff(radius) > 0).all()
            np.testing.assert_allclose(ray / radius[:, None], np.tile(ray[-1] / radius[-1], (len(ray), 1)), atol=1e-12)
            # Equal steps, the first from the mean body.
            np.testing.assert_allclose(np.diff(radius, prepend=0), radius[0], atol=1e-12)


def test_two_betas_fill_the_ellipse_and_interleave() -> None:
    protocol = make_protocol(2)
    assert len(protocol.rays) == 25
    ends = np.array([ray[-1] for ray in protocol.rays])
    np.testing.assert_allclose(((ends / EXTENT) ** 2).sum(axis=1), 1)
    for k, test in enumerate(protocol.test):
        assert (test[1:] != test[:-1]).all()
        if k:
            assert (test != protocol.test[k - 1]).all()
    share = [test.mean() for test in protocol.test]
    assert share == [0.5] * 25


@pytest.mark.parametrize(("num_betas", "rays"), [(1, 2), (2, 25)])
def test_every_ray_has_its_turn_once(num_betas: int, rays: int) -> None:
    assert sorted(make_protocol(num_betas).order) == list(range(rays))


def test_any_beginning_of_the_order_covers_all_directions() -> None:
    """No gap between directions is much wider than an even spread would leave."""
    order = make_protocol(2).order
    for count in range(2, 26):
        rays = np.sort(order[:count])
        gaps = np.diff(np.append(rays, rays[0] + 25))
        assert gaps.max() * count / 25 < 2.0
        # Both ways of interleaving test shapes are there: one alone would leave all outermost shapes untrained.
        assert 0.25 * count <= (rays % 2).sum() <= 0.75 * count


@pytest.mark.parametrize("num_betas", [0, 3, 10])
def test_no_other_protocol(num_betas: int) -> None:
    with pytest.raises(ValueError, match=f"num_betas = {num_betas} has no protocol; known: 1, 2"):
        make_protocol(num_betas)
