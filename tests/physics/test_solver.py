"""The implicit solver against mechanics whose answer is known."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scenes import horizontal, make_cloth, make_fabric, place, relax, run, sheet, slab, start, wavy
from scipy.integrate import solve_bvp
from scipy.optimize import brentq, minimize

from tryon_jax.physics.bending import bending_energy
from tryon_jax.physics.body_contact import SLIDING, ContactLaw
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.elasticity import deform, elastic_gradient
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.state import GRAVITY, ClothState, SolverSettings
from tryon_jax.physics.stretch import stretch_energy

EXACT = SolverSettings(linear_tolerance=1e-9, linear_iterations=2000, max_move=10.0)
"""Linear systems solved to the end, moves not capped."""
STATIC = dataclasses.replace(EXACT, retention=0.0, time_step=0.5, max_move=8e-3)
"""Regularised Newton steps to equilibrium."""


def test_free_fall_is_exact_backward_euler(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface = make_cloth(faces, uv), slab()
    settings = dataclasses.replace(EXACT, retention=1.0)
    h, steps = settings.time_step, 12
    points = horizontal(uv, 2.0)
    state, _ = run(start(place(points, cloth), cloth, surface), cloth, make_fabric(), surface, settings, steps)
    fallen = points[:, 1] - np.asarray(state.x)[: len(uv), 1]
    np.testing.assert_allclose(fallen, GRAVITY * h**2 * steps * (steps + 1) / 2, rtol=1e-9)
    np.testing.assert_allclose(np.asarray(state.x)[: len(uv), [0, 2]], points[:, [0, 2]], atol=1e-12)
    np.testing.assert_allclose(np.asarray(state.velocity)[: len(uv), 1], -GRAVITY * h * steps, rtol=1e-9)
    # Padding stays where it was put.
    assert (np.asarray(state.x)[len(uv) :] == 5.0).all()


def test_moves_are_capped(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface = make_cloth(faces, uv), slab()
    settings = dataclasses.replace(EXACT, max_move=1e-3)
    state = start(place(horizontal(uv, 2.0), cloth), cloth, surface)
    after, _ = run(state, cloth, make_fabric(), surface, settings, 1)
    np.testing.assert_allclose(np.linalg.norm(np.asarray(after.x - state.x)[: len(uv)], axis=1), 1e-3, rtol=1e-6)


@pytest.mark.parametrize("seed", [0, 1])
def test_energy_does_not_grow(x64: None, seed: int) -> None:
    """A strained, bent, whirling sheet in weightlessness without damping."""
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface, fabric = make_cloth(faces, uv), slab(), make_fabric(bending=1e-4)
    settings = dataclasses.replace(EXACT, retention=1.0, gravity=0.0, time_step=2e-4)
    points = wavy(uv, seed, scale=0.02)
    x = place(points + [0, 1.0, 0], cloth)
    speed = place(np.cross([5.0, 20.0, 10.0], points - points.mean(axis=0)), cloth) * cloth.active[:, None]
    state = dataclasses.replace(start(x, cloth, surface), velocity=speed)
    mass = cloth.vertex_areas * fabric.density

    @jax.jit
    def energy(state: ClothState) -> jax.Array:
        kinetic = 0.5 * (mass * (state.velocity**2).sum(1)).sum()
        return kinetic + stretch_energy(state.x, cloth, fabric) + bending_energy(state.x, cloth, fabric)

    energies = [float(energy(state))]
    momentum = np.asarray((mass[:, None] * state.velocity).sum(0))
    for _ in range(60):
        state, _ = run(state, cloth, fabric, surface, settings, 1)
        energies.append(float(energy(state)))
    assert (np.diff(energies) <= 1e-9 * energies[0]).all()
    assert energies[-1] > 0.01 * energies[0]
    np.testing.assert_allclose(np.asarray((mass[:, None] * state.velocity).sum(0)), momentum, atol=1e-6)


def strip(columns: int, length: float) -> tuple[np.ndarray, np.ndarray]:
    """One row of square cells."""
    return sheet(columns, 1, length, length / columns)


def test_heavy_strip_hangs_by_its_top(x64: None) -> None:
    """Stretch of a hanging bar: ρ g L² / 2k."""
    faces, uv = strip(24, 0.6)
    cloth, surface = make_cloth(faces, uv), slab()
    fabric = make_fabric(warp=300.0, shear=100.0, density=0.5)
    # The strip's length runs down.
    points = np.stack([uv[:, 1], 2.0 - uv[:, 0], 0 * uv[:, 0]], axis=1)
    top = np.flatnonzero(uv[:, 0] == 0)
    state, _ = relax(start(place(points, cloth), cloth, surface), cloth, fabric, surface, STATIC, top)
    assert (np.asarray(state.x)[top] == points[top]).all()
    bottom = np.flatnonzero(uv[:, 0] > 0.6 - 1e-9)
    longer = points[bottom, 1] - np.asarray(state.x)[bottom, 1]
    assert longer.mean() == pytest.approx(0.5 * GRAVITY * 0.6**2 / (2 * 300.0), rel=0.01)


def elastica(length: float, weight: float, rigidity: float) -> float:
    """Drop of the tip of a heavy cantilever: D θ'' = −w (L − s) cos θ, θ(0) = 0, θ'(L) = 0."""
    s = np.linspace(0, length, 200)
    answer = solve_bvp(
        lambda s, y: np.stack([y[1], -weight * (length - s) * np.cos(y[0]) / rigidity]),
        lambda a, b: np.array([a[0], b[1]]),
        s,
        np.zeros((2, 200)),
        tol=1e-8,
    )
    assert answer.success
    return float(np.trapezoid(np.sin(answer.sol(s)[0]), s))


def test_cantilever_is_the_heavy_elastica(x64: None) -> None:
    """Peirce's test, by minimising the energies of a strip that stays a cylinder.

    On square cells a hinge stiffness k then bends as a plate of rigidity k / 4.
    """
    length, density = 0.1, 0.2

    @jax.jit
    def energy(free: jax.Array, cloth: Cloth, fabric: Fabric, x: jax.Array) -> jax.Array:
        # Both vertices of a column move alike; columns beyond the strip do nothing.
        columns = jnp.repeat(free.reshape(-1, 2), 2, axis=0)
        x = x.at[4 : 4 + len(columns), :2].set(columns)
        weight = (cloth.vertex_areas * density * GRAVITY * x[:, 1]).sum()
        return stretch_energy(x, cloth, fabric) + bending_energy(x, cloth, fabric) + weight

    slope, curvature = jax.jit(jax.grad(energy)), jax.jit(jax.hessian(energy))
    for slenderness in (2.0, 12.0):
        rigidity = density * GRAVITY * length**3 / slenderness
        errors = []
        for columns in (8, 16):
            edge = length / columns
            faces, uv = strip(columns + 1, length + edge)
            cloth, fabric = make_cloth(faces, uv), make_fabric(warp=200.0, shear=80.0, bending=4 * rigidity)
            x = place(np.stack([uv[:, 0] - edge, np.zeros(len(uv)), -uv[:, 1]], axis=1), cloth)
            free = np.asarray(x[4:36:2, :2]).ravel()
            answer = minimize(energy, free, (cloth, fabric, x), "trust-exact", slope, curvature, options={"gtol": 1e-9})
            drop = -answer.x.reshape(-1, 2)[columns - 1, 1]
            # The first hinge turns as if the wall were half a cell before it.
            errors.append(abs(drop / elastica(length + 0.5 * edge, density * GRAVITY, rigidity) - 1))
        assert errors[1] < 0.01
        assert errors[1] < errors[0]


def test_a_slack_strip_is_a_catenary(x64: None) -> None:
    length, span = 0.48, 0.40
    faces, uv = strip(24, length)
    cloth, surface = make_cloth(faces, uv), slab()
    fabric = make_fabric(warp=3000.0, shear=1000.0, bending=1e-9, density=0.3)
    parameter = brentq(lambda a: 2 * a * np.sinh(span / (2 * a)) - length, 0.05, 10)
    sag = parameter * (np.cosh(span / (2 * parameter)) - 1)
    # Begin on a circle's arc of the same length.
    turn = brentq(lambda t: length / t * 2 * np.sin(t / 2) - span, 0.1, 6)
    angle = turn * (uv[:, 0] / length - 0.5)
    radius = length / turn
    points = np.stack([radius * np.sin(angle), 2 - radius * (np.cos(angle) - np.cos(turn / 2)), -uv[:, 1]], axis=1)
    ends = np.flatnonzero((uv[:, 0] == 0) | (uv[:, 0] > length - 1e-9))
    state, _ = relax(start(place(points, cloth), cloth, surface), cloth, fabric, surface, STATIC, ends, 1e-5)
    assert (np.asarray(state.x)[ends] == points[ends]).all()
    lowest = 2 - np.asarray(state.x)[: len(uv), 1].min()
    assert lowest == pytest.approx(sag, rel=0.01)


def test_resting_height_under_weight(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface = make_cloth(faces, uv), slab()
    fabric = make_fabric(density=0.4, thickness=0.004, bending=1e-4)
    state, report = relax(
        start(place(horizontal(uv, 0.01), cloth), cloth, surface), cloth, fabric, surface, STATIC, tolerance=1e-4
    )
    law, weight = ContactLaw(), 0.4 * GRAVITY
    depth = brentq(lambda d: law.soft * d + law.hard * d**3 / (3 * 0.004**2) - weight, 0, 0.004)
    np.testing.assert_allclose(np.asarray(state.x)[: len(uv), 1].mean(), 0.004 - depth, rtol=1e-4)
    assert float(report.depth) == pytest.approx(-(0.004 - depth), rel=1e-2)


@pytest.mark.parametrize("degrees", [10.0, 15.0, 19.0, 26.0])
def test_incline_sticks_below_and_slides_above_the_friction_angle(x64: None, degrees: float) -> None:
    """Friction 0.3: 16.7 degrees."""
    tilt = -np.deg2rad(degrees)
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface, fabric = make_cloth(faces, uv), slab(tilt), make_fabric(friction=0.3, density=0.3, bending=1e-4)
    cos, sin = np.cos(tilt), np.sin(tilt)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    points = horizontal(uv, 0.00397) @ turn.T
    downhill = turn @ np.array([1.0, 0, 0])
    settings = dataclasses.replace(EXACT, retention=1.0, time_step=0.01)
    state, _ = run(start(place(points, cloth), cloth, surface), cloth, fabric, surface, settings, 40)
    slid = float(((np.asarray(state.x)[: len(uv)] - points) @ downhill).mean())
    speed = float((np.asarray(state.velocity)[: len(uv)] @ downhill).mean())
    excess = 0.3 * GRAVITY * (np.sin(-tilt) - 0.3 * np.cos(tilt))
    if excess < 0:
        assert abs(slid) < 3e-4
        assert abs(speed) < 1e-9
    else:
        # What a sliding vertex keeps in the matrix is a drag: it creeps to its end instead of accelerating.
        assert speed == pytest.approx(excess / (SLIDING * ContactLaw().tangential * 0.01), rel=0.02)
        assert slid > 0.3 * 0.4 * speed


def test_a_moving_surface_drags_cloth_along_once(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, fabric = make_cloth(faces, uv), make_fabric(density=0.3, bending=1e-4)
    surface = slab()
    state, _ = relax(
        start(place(horizontal(uv, 0.00397), cloth), cloth, surface), cloth, fabric, surface, STATIC, tolerance=1e-4
    )
    motion = jnp.zeros_like(surface.vertices).at[:, 0].set(2e-3)
    moved = dataclasses.replace(surface, vertices=surface.vertices + motion)
    after, _ = run(state, cloth, fabric, moved, STATIC, 20, motion=motion)
    ridden = np.asarray(after.x - state.x)[: len(uv), 0]
    np.testing.assert_allclose(ridden, 2e-3, atol=1e-4)


def test_turning_everything_about_the_vertical_turns_the_result(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, fabric = make_cloth(faces, uv), make_fabric()
    surface = slab()
    cos, sin = np.cos(0.7), np.sin(0.7)
    turn = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    results = []
    points = horizontal(uv, 0.003) + 0.002 * np.random.default_rng(0).normal(size=(len(uv), 3))
    for rotation in (np.eye(3), turn):
        surface_turned = slab()
        vertices = surface.vertices @ jnp.asarray(rotation.T)
        normals = surface.normals @ jnp.asarray(rotation.T)
        surface_turned = dataclasses.replace(surface_turned, vertices=vertices, normals=normals)
        state = start(place(points @ rotation.T, cloth), cloth, surface_turned)
        state, _ = run(state, cloth, fabric, surface_turned, EXACT, 5)
        results.append(np.asarray(state.x)[: len(uv)])
    np.testing.assert_allclose(results[1], results[0] @ turn.T, atol=1e-8)


def test_solve_stops_at_its_tolerance_or_its_steps(x64: None) -> None:
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface, fabric = make_cloth(faces, uv), slab(), make_fabric(bending=1e-4)
    state = start(place(horizontal(uv, 0.01), cloth), cloth, surface)
    _, report = run(state, cloth, fabric, surface, STATIC, 500, tolerance=1e-3)
    assert float(report.residual) <= 1e-3
    assert 1 < int(report.steps) < 500
    _, report = run(state, cloth, fabric, surface, STATIC, 4)
    assert int(report.steps) == 4


@pytest.mark.parametrize("most", [3, 500])
def test_the_report_is_that_of_the_state_handed_back(x64: None, most: int) -> None:
    """Whether the tolerance ends the solve or its steps: asked again for no step, the state has the same residual."""
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface, fabric = make_cloth(faces, uv), slab(), make_fabric(bending=1e-4)
    state = start(place(horizontal(uv, 0.01), cloth), cloth, surface)
    state, report = run(state, cloth, fabric, surface, STATIC, most, tolerance=1e-3)
    assert (float(report.residual) <= 1e-3) == (most == 500)
    same, again = run(state, cloth, fabric, surface, STATIC, 0, tolerance=1e-3)
    assert int(again.steps) == int(again.iterations) == 0
    assert float(again.residual) == pytest.approx(float(report.residual), rel=1e-9)
    assert float(again.depth) == pytest.approx(float(report.depth), rel=1e-9)
    for one, other in zip(jax.tree.leaves(same), jax.tree.leaves(state), strict=True):
        np.testing.assert_array_equal(one, other)


def test_float32_agrees() -> None:
    """The precision of a device: the same equilibrium within a hundredth of a millimetre, whatever the padding."""
    faces, uv = sheet(5, 4, 0.1, 0.08)
    fabric, surface = make_fabric(), slab(dtype=np.float32)
    points = horizontal(uv, 0.003) + 0.002 * np.random.default_rng(1).normal(size=(len(uv), 3))
    results = []
    cloth = make_cloth(faces, uv, np.float32)
    state, _ = run(start(place(points, cloth), cloth, surface), cloth, fabric, surface, STATIC, 5)
    results.append(np.asarray(state.x)[: len(uv)])
    assert state.x.dtype == jnp.float32
    with jax.enable_x64(True):
        fabric, surface = make_fabric(), slab()
        cloth = make_cloth(faces, uv)
        state, _ = run(start(place(points, cloth), cloth, surface), cloth, fabric, surface, STATIC, 5)
        results.append(np.asarray(state.x)[: len(uv)])
    np.testing.assert_allclose(results[0], results[1], atol=1e-5)


@pytest.mark.slow
def test_single_precision_feels_what_its_positions_cannot_hold() -> None:
    """Forces of stiff cloth a metre from the origin, from positions in two parts, against double precision."""
    faces, uv = sheet(5, 4, 0.1, 0.08)
    fabric = make_fabric(warp=5000.0)
    exact = horizontal(uv) + 1e-5 * np.random.default_rng(2).normal(size=(len(uv), 3)) + [1.0, 0.7, -0.8]
    cut = exact.astype(np.float32)
    cloth = make_cloth(faces, uv, np.float32)
    rest = place(exact - cut, cloth) * cloth.active[:, None]
    coarse, fine = (elastic_gradient(deform(place(cut, cloth), cloth, fabric, part), cloth) for part in (None, rest))
    with jax.enable_x64(True):
        cloth = make_cloth(faces, uv)
        wanted = np.asarray(elastic_gradient(deform(place(exact, cloth), cloth, make_fabric(warp=5000.0)), cloth))
    size = np.abs(wanted).max()
    assert np.abs(np.asarray(coarse) - wanted).max() > 1e-3 * size
    np.testing.assert_allclose(fine, wanted, atol=1e-4 * size)


def test_steps_lose_no_digit_of_the_moves() -> None:
    """Two thousand moves far below the last digit of the positions add up."""
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface = make_cloth(faces, uv, np.float32), slab(dtype=np.float32)
    # A step of free fall from rest without memory moves by g h²: 1 nm, where the digits of 2 m end at 0.1 µm.
    settings = dataclasses.replace(EXACT, retention=0.0, time_step=1e-5)
    state = start(place(horizontal(uv, 2.0), cloth), cloth, surface)
    after, _ = run(state, cloth, make_fabric(), surface, settings, 2000)
    moved = np.float64(after.x) + np.float64(after.remainder) - np.float64(state.x)
    np.testing.assert_allclose(moved[: len(uv), 1], -2000 * GRAVITY * 1e-10, rtol=1e-4)
    assert (np.abs(after.remainder)[: len(uv), 1] <= 2.0**-23).all()


def test_stiff_cloth_comes_to_rest_in_single_precision() -> None:
    """A woven strip that hangs by its top, a metre from the origin: without the remainder its residual stays high."""
    faces, uv = sheet(5, 4, 0.1, 0.08)
    cloth, surface, fabric = make_cloth(faces, uv, np.float32), slab(dtype=np.float32), make_fabric(warp=5000.0)
    hung = np.stack([uv[:, 0] + 1.0, uv[:, 1] + 1.0, np.zeros(len(uv))], axis=1)
    pinned = uv[:, 1] > uv[:, 1].max() - 1e-6
    pinned = np.concatenate([pinned, np.zeros(len(cloth.active) - len(uv), bool)])
    state = forgetful = start(place(hung, cloth), cloth, surface)
    for _ in range(40):
        state, report = run(state, cloth, fabric, surface, STATIC, 1, pinned)
        forgetful, _ = run(forgetful, cloth, fabric, surface, STATIC, 1, pinned)
        forgetful = dataclasses.replace(forgetful, remainder=jnp.zeros_like(forgetful.x))
    _, without = run(forgetful, cloth, fabric, surface, STATIC, 0, pinned)
    assert float(report.residual) < 0.02
    assert float(without.residual) > 0.2
