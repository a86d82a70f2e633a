"""How many bodies a design needs: exact where drapes are linear in the betas, whatever ray is left out."""

import numpy as np
import pytest

from experiments.beyond.bodies import markdown, measure, rays_of
from experiments.shared.neighbours import Drapes


def drapes(bend: float = 0.0) -> Drapes:
    angles, radius = np.array([0.2, 1.7, 3.3, 5.0]), np.arange(1, 9) / 8
    betas = np.concatenate([[[0, 0]], *(r * np.stack([3 * np.cos(angles), 2 * np.sin(angles)], 1) for r in radius)])
    rng = np.random.default_rng(0)
    mean, fields = rng.normal(size=(20, 3)), rng.normal(size=(3, 20, 3))
    curved = np.concatenate([betas, bend * betas[:, :1] ** 2], axis=1)
    moved = mean[None] + 0.01 * np.einsum("sk,kvc->svc", curved, fields)
    good = np.ones(len(betas), bool)
    ties = np.zeros((20, 3), int), np.ones((20, 3)) / 3
    return Drapes("tshirt-0", mean.astype(np.float32), np.zeros(3), betas, moved, good, ~good, *ties)


def test_rays_are_found_in_order():
    rays = rays_of(drapes().betas)
    assert [len(ray) for ray in rays] == [8] * 4
    for ray in rays:
        assert (np.diff(np.linalg.norm(drapes().betas[ray], axis=1)) > 0).all()


def test_linear_drapes_need_two_directions_and_no_more():
    found = measure(drapes(), (2,))
    assert found["2 rays, all shapes"]["best, 2"] == pytest.approx(0.0, abs=1e-3)
    assert found["1 rays, all shapes"]["best, 2"] > 1.0
    assert found["3 rays, all shapes"]["interpolated"] < found["1 rays, all shapes"]["interpolated"]


def test_a_field_too_few_is_seen():
    found = measure(drapes(bend=0.5), (2, 3))["3 rays, every second shape"]
    assert found["best, 3"] == pytest.approx(0.0, abs=1e-3)
    assert found["best, 2"] > 0.1
    text = "\n".join(markdown({"designs": 1, "fields": (2, 3), "rows": {"3 rays": found}}))
    assert "| 3 rays | 13 |" in text
