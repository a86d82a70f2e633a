"""Drapes side by side: the same as one by one, whatever the company."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import horizontal, make_cloth, make_fabric, place, run, sheet, slab, start, wavy
from round_body import RADIUS, make_ball

from tryon_jax.physics.batch import dress_many, solve_many, stack, stack_cloths, stack_fabrics, sweep_many
from tryon_jax.physics.block_matrix import multiply
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, dress, follow
from tryon_jax.physics.elasticity import deform, elastic_blocks, elastic_gradient
from tryon_jax.physics.incidence import widen
from tryon_jax.physics.state import SolverSettings

pytestmark = pytest.mark.usefixtures("unchecked")

MESHES = (sheet(10, 10, 0.4, 0.4), sheet(8, 12, 0.3, 0.4))
CLOTHS = [make_cloth(*mesh, np.float32, bucket=128) for mesh in MESHES]
FABRICS = [
    dataclasses.replace(make_fabric(warp=w, shear=60.0, bending=2e-5), name=name)
    for w, name in ((200, "a"), (400, "b"))
]
STARTS = [horizontal(uv, RADIUS + 0.005) for _, uv in MESHES]
SETTINGS = SolverSettings()
EQUILIBRIUM = Equilibrium(tolerance=2e-2)


@pytest.fixture(scope="module")
def obstacle() -> Obstacle:
    return Obstacle(make_ball())


@pytest.fixture(scope="module")
def together(obstacle: Obstacle, unchecked: None) -> list[Drape]:
    return dress_many(STARTS, CLOTHS, FABRICS, obstacle, SETTINGS, EQUILIBRIUM, betas=(0.0,))


def apart(one: Drape, other: Drape) -> float:
    return float(np.linalg.norm(one.vertices - other.vertices, axis=1).mean())


@pytest.mark.slow
def test_each_lane_takes_the_steps_it_takes_alone(x64: None, obstacle: Obstacle) -> None:
    """In double precision, where rounding cannot grow into another fold: lanes that move, stop early, or wait."""
    cloths = [make_cloth(*mesh, np.float64, bucket=128) for mesh in MESHES]
    body = slab()
    states = [start(place(p + [0, 0.003 - RADIUS, 0], c), c, body) for p, c in zip(STARTS, cloths, strict=True)]
    motions = jnp.zeros((2, *body.vertices.shape)).at[0, :, 0].set(1e-3)
    bodies, goal = jnp.stack([body.vertices] * 2), jnp.asarray(1e-2)
    held = np.zeros((2, 128), bool)
    held[0, :3] = True
    for most in ((12, 4), (0, 12)):
        after, report = solve_many(
            stack(states),
            stack_cloths(cloths),
            stack_fabrics(FABRICS),
            body,
            bodies,
            SETTINGS,
            motions,
            goal,
            jnp.array(most),
            jnp.asarray(held),
        )
        assert (after.x[held] == stack(states).x[held]).all()
        for k in range(2):
            alone, expected = run(states[k], cloths[k], FABRICS[k], body, SETTINGS, most[k], held[k], 1e-2, motions[k])
            np.testing.assert_allclose(after.x[k], alone.x, atol=1e-10)
            np.testing.assert_allclose(after.slip[k], alone.slip, atol=1e-10)
            assert int(report.steps[k]) == int(expected.steps) <= most[k]


@pytest.mark.slow
def test_dressing_side_by_side_is_dressing_one_by_one(obstacle: Obstacle, together: list[Drape]) -> None:
    for points, cloth, fabric, drape in zip(STARTS, CLOTHS, FABRICS, together, strict=True):
        alone = dress(points, cloth, fabric, obstacle, SETTINGS, EQUILIBRIUM, betas=(0.0,))
        assert drape.num_vertices == len(points)
        assert drape.converged(EQUILIBRIUM)
        # In float32 rounding alone moves a drape within the residual's tolerance, as half the time step does (1.7 mm);
        # that lanes are single runs, to 1e-10, is tested in float64.
        assert apart(drape, alone) < 3e-3


@pytest.mark.slow
def test_sweeping_side_by_side_is_sweeping_one_by_one(obstacle: Obstacle, together: list[Drape]) -> None:
    """Each lane along its own ray, from the very same states."""
    rays = np.array([[[0.5], [1.0]], [[-0.25], [-0.5]]])
    alone = list(together)
    for step, lanes in enumerate(sweep_many(together, rays, CLOTHS, FABRICS, obstacle, SETTINGS, EQUILIBRIUM)):
        for k, (lane, cloth, fabric) in enumerate(zip(lanes, CLOTHS, FABRICS, strict=True)):
            alone[k] = follow(alone[k], rays[k, step], cloth, fabric, obstacle, SETTINGS, EQUILIBRIUM)
            np.testing.assert_array_equal(lane.betas, rays[k, step])
            np.testing.assert_array_equal(lane.surface.vertices, alone[k].surface.vertices)
            assert lane.converged(EQUILIBRIUM)
            # As above: what rounding may do in float32.
            assert apart(lane, alone[k]) < 3e-3
            assert (np.asarray(lane.state.x)[len(STARTS[k]) :] == 5.0).all()


@pytest.mark.slow
def test_a_lane_that_left_the_numbers_harms_no_other(obstacle: Obstacle, together: list[Drape]) -> None:
    broken = dataclasses.replace(FABRICS[1], bending=jnp.full((3, 5), jnp.nan))
    rays = np.array([[[0.5]], [[0.5]]])
    pair = [FABRICS[0], broken]
    [[good, bad]] = sweep_many(together, rays, CLOTHS, pair, obstacle, SETTINGS, EQUILIBRIUM)
    alone = follow(together[0], rays[0, 0], CLOTHS[0], FABRICS[0], obstacle, SETTINGS, EQUILIBRIUM)
    assert apart(good, alone) < 5e-4
    assert good.converged(EQUILIBRIUM)
    assert not np.isfinite(float(bad.report.residual))
    assert not bad.converged(EQUILIBRIUM)


def fan(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles around the first vertex: it has `count` neighbours."""
    turn = 2 * np.pi * np.arange(count) / count
    uv = 0.05 * np.concatenate([[[0, 0]], np.stack([np.cos(turn), np.sin(turn)], axis=1)])
    around = 1 + np.arange(count)
    return np.stack([0 * around, around, np.roll(around, -1)], axis=1), uv


def test_wider_rows_are_the_same_matrix(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, fabric = make_cloth(faces, uv), make_fabric()
    wide = widen(cloth.incidence, [make_cloth(*fan(13)).incidence], len(cloth.face_areas), len(cloth.hinge_shape))
    assert len(wide.neighbours) == 13 > len(cloth.incidence.neighbours)
    x, y = place(wavy(uv, 0), cloth), jnp.asarray(np.random.default_rng(0).normal(size=(3, 64)))
    gradients, products = [], []
    for each in (cloth, dataclasses.replace(cloth, incidence=wide)):
        deformation = deform(x, each, fabric)
        gradients.append(elastic_gradient(deformation, each))
        products.append(multiply(elastic_blocks(deformation, each, fabric), jnp.asarray(each.incidence.neighbours), y))
    np.testing.assert_array_equal(gradients[0], gradients[1])
    np.testing.assert_allclose(products[0], products[1], rtol=1e-12)


def test_only_cloths_of_one_bucket_stack() -> None:
    small = make_cloth(*sheet(5, 4, 0.1, 0.08), np.float32)
    with pytest.raises(ValueError, match=r"one size bucket to be stacked, got \[64, 128\]"):
        stack_cloths([CLOTHS[0], small])
    stacked = stack_cloths([CLOTHS[0], make_cloth(*fan(15), np.float32, bucket=128)])
    assert stacked.incidence.neighbours.shape == (2, 15, 128)
    assert stack_fabrics(FABRICS).density.shape == (2,)
