"""The derivative of the pattern by the design is that of the pattern carried to other outlines."""

import numpy as np
import pytest

from tryon_jax.garment import load_design_space, remesh
from tryon_jax.garment.pattern_derivative import carry_pattern, pattern_derivative
from tryon_jax.mesh.quality import signed_areas

SPACE = load_design_space("kimono")
AREA = 4e-3


@pytest.fixture(scope="module")
def mesh():
    return remesh(SPACE, SPACE.preset("tshirt"), AREA, seed=0)


def test_the_derivative_is_that_of_the_carried_pattern(mesh):
    slope = pattern_derivative(SPACE, mesh)
    assert slope.shape == (*mesh.uv.shape, len(SPACE.names))
    for k, name in enumerate(SPACE.names):
        values = mesh.design.as_dict()
        step = 2e-3 if values[name] + 2e-3 < SPACE.maximum[k] else -2e-3
        moved = carry_pattern(SPACE, mesh, SPACE.design(**(values | {name: values[name] + step})))
        difference = (moved - mesh.uv) / step
        assert np.abs(difference).max() > 0.1, name
        assert np.linalg.norm(slope[..., k] - difference) < 0.05 * np.linalg.norm(difference), name


def test_outlines_are_those_of_the_other_design_and_no_triangle_turns_over(mesh):
    values = mesh.design.as_dict()
    other = SPACE.design(**(values | {"length": values["length"] + 0.01}))
    uv = carry_pattern(SPACE, mesh, other)
    np.testing.assert_allclose(carry_pattern(SPACE, mesh, mesh.design), mesh.uv, atol=1e-12)
    assert (uv[:, 1].max() - uv[:, 1].min()) - np.ptp(mesh.uv[:, 1]) == pytest.approx(0.01, abs=1e-3)
    before, after = (signed_areas(points, mesh.faces_uv) for points in (mesh.uv, uv))
    assert (np.sign(before) == np.sign(after)).all()


def test_a_mesh_of_another_space_is_refused(mesh):
    fewer = load_design_space("kimono", parameters=SPACE.names[:1])
    with pytest.raises(ValueError, match="was not made in this design space"):
        pattern_derivative(fewer, mesh)
