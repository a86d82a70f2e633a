"""The solver of inverse problems, on one with a known answer."""

import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.garment import load_design_space
from tryon_jax.wear.unknowns import Unknowns, solve

pytestmark = pytest.mark.usefixtures("unchecked")


def misses(units, args):
    unknowns, wanted = args
    return jnp.concatenate([1e3 * (unknowns.values(units) - wanted), unknowns.beyond(units)])


def test_the_solver_finds_what_is_in_range_and_stays_near_it_otherwise():
    space = load_design_space()
    unknowns = Unknowns.of(space, (3.0, 2.0))
    inside = np.concatenate([space.minimum + 0.3 * (space.maximum - space.minimum), [1.0, -0.5]]).astype(np.float32)
    np.testing.assert_allclose(unknowns.values(unknowns.units(inside)), inside, atol=1e-6)
    found = solve(misses, np.zeros(5, np.float32), (unknowns, inside), 30)
    np.testing.assert_allclose(unknowns.values(found.units), inside, atol=1e-4)
    assert found.residual < 0.1
    # Ten metres of garment: the wall holds it near the longest there is.
    outside = inside.copy()
    outside[2] = 10.0
    found = solve(misses, np.zeros(5, np.float32), (unknowns, outside), 30)
    assert unknowns.values(found.units)[0] == pytest.approx(inside[0], abs=1e-3)
    assert found.residual > 100
