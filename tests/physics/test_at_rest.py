"""Derivatives of cloth at rest against finite differences of the solver itself, in double precision."""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from cloth_scenes import horizontal, make_cloth, make_fabric, place, relax, run, sheet, slab, start

from tryon_jax.contact.surface import build_surface, move_surface
from tryon_jax.garment import Design, load_design_space, placement, remesh
from tryon_jax.garment.pattern_derivative import carry_pattern, pattern_derivative
from tryon_jax.physics.at_rest import at_rest
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.rest_shape import PatternNearDesign, find_rest_corners, uv_near, with_rest_shape
from tryon_jax.physics.state import SolverSettings

FACES, UV = sheet(7, 6, 0.14, 0.12)
SETTINGS = SolverSettings(retention=0.0, linear_tolerance=1e-8, linear_iterations=2000)
STILL = 1e-6
RNG = np.random.default_rng(0)
PROBE = RNG.normal(size=(len(UV), 3))


def compiled_jvp(value: Callable[[jax.Array], jax.Array], here: jax.Array) -> Callable[[jax.Array], tuple]:
    """Value and derivative along any direction, by one program: op by op there would be hundreds."""
    return jax.jit(lambda direction: jax.jvp(value, (here,), (direction,)))


def probe(x: jax.Array) -> jax.Array:
    """One number of a drape: a random weighted sum of its positions."""
    return (x[: len(UV)] * PROBE).sum()


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_a_sheet_that_hangs_by_two_corners() -> None:
    cloth, surface = make_cloth(FACES, UV), slab()
    corners = find_rest_corners(cloth, FACES, FACES, len(UV))
    fabric = make_fabric(warp=60.0, shear=30.0, bending=2e-5, density=0.3)
    pins = np.array([0, len(UV) - 1])
    points = horizontal(UV, 1.0)
    rest, _ = relax(start(place(points, cloth), cloth, surface), cloth, fabric, surface, SETTINGS, pins, STILL, 3000)
    pinned = jnp.zeros(len(cloth.active), bool).at[pins].set(True)

    def changed(values: jax.Array) -> tuple:
        stiffer = replace(
            fabric,
            density=fabric.density * values[0],
            stretch_table=fabric.stretch_table * values[1],
            bending=fabric.bending * values[2],
        )
        return with_rest_shape(cloth, corners, jnp.asarray(UV) * values[3:][None, :]), stiffer

    def value(values: jax.Array) -> jax.Array:
        cut, stiffer = changed(values)
        return probe(at_rest(rest, cut, stiffer, surface, SETTINGS, pinned, tolerance=1e-10))

    ones = jnp.ones(5)
    found = jax.jit(jax.grad(value))(ones)
    at_ones, forward = compiled_jvp(value, ones)(jnp.arange(1.0, 6.0))
    np.testing.assert_allclose(at_ones, probe(rest.x + rest.remainder), rtol=1e-12)
    assert forward == pytest.approx(float((found * jnp.arange(1.0, 6.0)).sum()), rel=1e-5)
    for k in range(5):
        ends = []
        for sign in (-1, 1):
            cut, stiffer = changed(ones.at[k].add(sign * 5e-3))
            state, _ = run(rest, cut, stiffer, surface, SETTINGS, 3000, pins, STILL)
            ends.append(float(probe(state.x + state.remainder)))
        assert found[k] == pytest.approx((ends[1] - ends[0]) / 1e-2, rel=0.03, abs=1e-3), f"parameter {k}"


BALL = trimesh.creation.icosphere(subdivisions=3)


def ball(radius: float | jax.Array = 0.1, shift: float | jax.Array = 0.0) -> jax.Array:
    """Vertices of a ball whose middle is moved along z, metres."""
    return jnp.asarray(np.asarray(BALL.vertices)) * radius + shift * jnp.array([[0.0, 0.0, 1.0]])


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_a_cloth_held_over_a_ball_without_friction() -> None:
    surface = build_surface(np.asarray(ball()), np.asarray(BALL.faces))
    cloth = make_cloth(FACES, UV)
    fabric = make_fabric(warp=60.0, shear=30.0, bending=2e-5, density=0.3, friction=0.0, thickness=0.003)
    pins = np.array([0, 6, len(UV) - 7, len(UV) - 1])
    laid = horizontal(UV, 0.103) * np.array([0.9, 1.0, 0.9])
    state = start(place(laid, cloth), cloth, surface)
    rest, _ = relax(state, cloth, fabric, surface, SETTINGS, pins, 2e-7, 3000)
    pinned = jnp.zeros(len(cloth.active), bool).at[pins].set(True)

    def scene(values: jax.Array) -> tuple:
        changed = replace(fabric, thickness=fabric.thickness * values[1], density=fabric.density * values[2])
        return changed, move_surface(surface, ball(0.1 * values[0]))

    def value(values: jax.Array) -> jax.Array:
        return at_rest(rest, cloth, *scene(values), SETTINGS, pinned, tolerance=1e-10)

    here = jnp.ones(3)
    derivative = compiled_jvp(value, here)
    for k, step in enumerate((1e-4, 1e-3, 1e-3)):
        ends = []
        for sign in (-1, 1):
            changed, moved = scene(here.at[k].add(sign * step))
            motion = moved.vertices - surface.vertices
            after, _ = run(rest, cloth, changed, moved, SETTINGS, 3000, pins, 2e-7, motion)
            ends.append(np.asarray(after.x + after.remainder)[: len(UV)])
        expected = (ends[1] - ends[0]) / (2 * step)
        found = derivative(jnp.zeros(3).at[k].set(1.0))[1][: len(UV)]
        assert np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected), f"parameter {k}"


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_a_cloth_that_sticks_goes_with_the_body() -> None:
    surface = build_surface(np.asarray(ball()), np.asarray(BALL.faces))
    cloth = make_cloth(FACES, UV)
    fabric = make_fabric(warp=60.0, shear=30.0, bending=2e-5, density=0.3, friction=0.6, thickness=0.003)
    state = start(place(horizontal(UV, 0.103), cloth), cloth, surface)
    rest, _ = relax(state, cloth, fabric, surface, SETTINGS, None, 1e-8, 3000)

    def value(shift: jax.Array) -> jax.Array:
        moved = move_surface(surface, ball(shift=shift))
        return at_rest(rest, cloth, fabric, moved, SETTINGS, tolerance=1e-10)[: len(UV)]

    _, along = compiled_jvp(value, jnp.zeros(()))(jnp.ones(()))
    np.testing.assert_allclose(along, np.broadcast_to([0.0, 0.0, 1.0], along.shape), atol=1e-4)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_a_garment_by_its_design() -> None:
    """A coarse T-shirt that hangs by neck and upper seams: derivatives by the design against patterns cut anew."""
    space = load_design_space("kimono")
    mesh = remesh(space, space.preset("tshirt"), 5e-3, seed=0)
    count, surface = mesh.num_vertices, slab()
    fabric = make_fabric(warp=60.0, shear=30.0, bending=2e-4, density=0.3)
    pins = np.unique(np.concatenate([mesh.loops["neck"], *(v for n, v in mesh.seams.items() if "overarm" in n)]))

    def cut(uv: np.ndarray) -> Cloth:
        return build_cloth(mesh.faces, uv, mesh.faces_uv, count, bucket=128, dtype=np.float64)

    cloth = cut(mesh.uv)
    state = start(place(placement(mesh) + [0.0, 2.0, 0.0], cloth), cloth, surface)
    rest, _ = relax(state, cloth, fabric, surface, SETTINGS, pins, STILL, 4000)
    pinned = jnp.zeros(len(cloth.active), bool).at[pins].set(True)
    corners = find_rest_corners(cloth, mesh.faces, mesh.faces_uv, count)
    pattern = PatternNearDesign(mesh.design.values, mesh.uv, pattern_derivative(space, mesh))

    def value(design: jax.Array) -> jax.Array:
        sewn = with_rest_shape(cloth, corners, uv_near(pattern, design))
        return at_rest(rest, sewn, fabric, surface, SETTINGS, pinned, tolerance=1e-10)[:count]

    here = jnp.asarray(mesh.design.values)
    derivative = compiled_jvp(value, here)
    for k, name in enumerate(space.names):
        ends = []
        for sign in (-1, 1):
            design = Design(space.names, mesh.design.values + sign * 1e-3 * np.eye(len(space.names))[k])
            after, _ = run(rest, cut(carry_pattern(space, mesh, design)), fabric, surface, SETTINGS, 4000, pins, STILL)
            ends.append(np.asarray(after.x + after.remainder)[:count])
        expected = (ends[1] - ends[0]) / 2e-3
        found = derivative(jnp.zeros(len(here)).at[k].set(1.0))[1]
        assert np.linalg.norm(expected) > 0.1, name
        assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected), name
