"""Which functions of the kernel are kept."""

import numpy as np
import pytest

from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.training.kernel_choice import choose_functions, spread_points
from tryon_jax.training.node_drapes import NodeDrapes


def drapes(count: int = 60, seed: int = 0) -> NodeDrapes:
    rng = np.random.default_rng(seed)
    designs, shapes = rng.uniform(-1, 1, (count, 3)), rng.uniform(-1, 1, (count, 2))
    arrays = [np.zeros((count, 6)), np.repeat(designs[: count // 4], 4, axis=0), shapes]
    fields, designs, shapes = (array.astype(np.float32) for array in arrays)
    edges = np.zeros((1, 2), np.int32)
    return NodeDrapes(edges, np.zeros(3), np.ones(3), np.ones(2), fields, designs, shapes, {"a-0": np.arange(count)})


def test_points_are_spread() -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (500, 2)).astype(np.float32)
    chosen = spread_points(points, 20)
    assert len(np.unique(chosen, axis=0)) == 20
    assert {tuple(row) for row in chosen.tolist()} <= {tuple(row) for row in points.tolist()}
    assert np.linalg.norm(chosen[0]) == np.linalg.norm(points, axis=1).min()
    # The farthest point from the chosen ones is no farther than the last was when it was chosen.
    left = np.linalg.norm(points[:, None] - chosen[None], axis=2).min(axis=1).max()
    assert left <= np.linalg.norm(chosen[-1] - chosen[:-1], axis=1).min() + 1e-6


def test_too_few_points_are_added_to() -> None:
    points = np.array([[0.0, 0.5], [0.5, 0.0], [0.0, 0.5]], np.float32)
    chosen = spread_points(points, 10)
    assert {tuple(row) for row in chosen[:2].tolist()} == {(0.0, 0.5), (0.5, 0.0)}
    assert len(np.unique(chosen, axis=0)) == 10
    assert np.abs(chosen).max() <= 1.0


def test_the_products_of_largest_variance_are_kept_then_the_trend() -> None:
    config = KrigingConfig(designs=9, shapes=5, functions=20)
    chosen = choose_functions(drapes(), config)
    first, second = chosen.pairs
    assert len(first) == len(second) == 20 + 12
    pairs = list(zip(first.tolist(), second.tolist(), strict=True))
    assert len(set(pairs)) == len(pairs)
    one, other = (1.0 / np.diag(np.asarray(f.factor)) ** 2 for f in (chosen.designs, chosen.shapes))
    kept = [one[i] * other[k] for i, k in pairs[:20]]
    left = [one[i] * other[k] for i in range(9) for k in range(5) if (i, k) not in pairs[:20]]
    assert min(kept) >= max(left)
    assert (first[20:].min(), first[20:].max(), second[20:].min(), second[20:].max()) == (9, 12, 5, 7)


def test_their_values_are_products() -> None:
    some = drapes(seed=3)
    chosen = choose_functions(some, KrigingConfig(designs=9, shapes=5, functions=45))
    values = chosen(some)
    assert values.shape == (60, 57)
    # The first product is of the kernels at the first centres; the last ones are the trend.
    at = some.designs - np.asarray(chosen.designs.centres)[0], some.shapes - np.asarray(chosen.shapes.centres)[0]
    far = [np.sqrt(3.0) * np.linalg.norm(offset, axis=1) for offset in at]
    np.testing.assert_allclose(values[:, 0], np.prod([(1 + r) * np.exp(-r) for r in far], axis=0), atol=1e-5)
    np.testing.assert_allclose(values[:, 45], 1.0)
    np.testing.assert_allclose(values[:, -1], some.designs[:, 2] * some.shapes[:, 1], atol=1e-6)


def test_more_products_than_there_are_are_refused() -> None:
    with pytest.raises(ValueError, match=r"functions of the process .* 46"):
        choose_functions(drapes(), KrigingConfig(designs=9, shapes=5, functions=46))
