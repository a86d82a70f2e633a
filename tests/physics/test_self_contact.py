"""Cloth against itself: pairs, forces, and a folded sheet that would fall through itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from cloth_scenes import ClothState, horizontal, jitted_solve, make_cloth, make_fabric, place, sheet, slab, start

from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.physics.body_contact import ContactLaw, pressure
from tryon_jax.physics.self_contact import SelfContact, SelfPairs, find_pairs, self_contact
from tryon_jax.physics.state import SolverSettings

SETTINGS = SelfContact(thickness=0.004, reach=0.012, rings=2, capacity=256)
LAW = ContactLaw()


def two_layers(gap: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Two sheets of one mesh, the second above the first and shifted by a third of a cell."""
    faces, uv = sheet(4, 4, 0.08, 0.08)
    noise = 2e-4 * np.random.default_rng(seed).normal(size=(2 * len(uv), 3))
    lower, upper = horizontal(uv), horizontal(uv, gap) + [0.007, 0, 0.006]
    return np.concatenate([lower, upper]) + noise, np.concatenate([faces, faces + len(uv)])


def brute_force(points: np.ndarray, faces: np.ndarray, reach: float) -> set[tuple[int, tuple[int, ...]]]:
    found = set()
    half = len(points) // 2
    for vertex, point in enumerate(points):
        distance = np.linalg.norm(
            point - trimesh.triangles.closest_point(points[faces], np.tile(point, (len(faces), 1))), axis=1
        )
        for face in np.flatnonzero(distance < reach):
            # Within a flat layer nothing is near but what the rings leave out.
            if (faces[face, 0] < half) != (vertex < half):
                found.add((vertex, tuple(faces[face].tolist())))
    return found


def as_set(pairs: SelfPairs) -> set[tuple[int, tuple[int, ...]]]:
    used = np.asarray(pairs.side) != 0
    vertex, triangle = np.asarray(pairs.vertex)[used], np.asarray(pairs.triangle)[used]
    return {(int(v), tuple(t.tolist())) for v, t in zip(vertex, triangle, strict=True)}


def test_pairs_are_all_within_reach_and_on_their_side(x64: None) -> None:
    points, faces = two_layers(0.006)
    pairs, overflow = find_pairs(points, faces, SETTINGS, 512)
    assert not overflow
    assert as_set(pairs) == brute_force(points, faces, SETTINGS.reach)
    used = np.asarray(pairs.side) != 0
    side, vertex = np.asarray(pairs.side)[used], np.asarray(pairs.vertex)[used]
    # Faces look up: the lower layer's vertices are on the back of the upper one.
    np.testing.assert_array_equal(side, np.where(vertex < 25, -1.0, 1.0))


def test_overflow_is_flagged_and_the_nearest_stay(x64: None) -> None:
    points, faces = two_layers(0.006)
    everything = as_set(find_pairs(points, faces, SETTINGS, 512)[0])
    pairs, overflow = find_pairs(points, faces, SETTINGS, 40)
    assert overflow
    assert len(as_set(pairs)) == 40
    assert as_set(pairs) < everything
    exact, overflow = find_pairs(points, faces, SETTINGS, len(everything))
    assert not overflow
    assert as_set(exact) == everything


def test_one_flat_sheet_has_no_pairs() -> None:
    faces, uv = sheet(6, 6, 0.12, 0.12)
    pairs, overflow = find_pairs(horizontal(uv).astype(np.float32), faces, SETTINGS, 16)
    assert not overflow
    assert not np.asarray(pairs.side).any()
    assert pairs.side.dtype == jnp.float32


def test_sides_survive_a_passage(x64: None) -> None:
    points, faces = two_layers(0.002)
    before, _ = find_pairs(points, faces, SETTINGS, 512)
    passed = points.copy()
    passed[25:, 1] -= 0.004
    after, _ = find_pairs(passed, faces, SETTINGS, 512, before)
    used = np.asarray(after.side) != 0
    kept = np.where(np.asarray(after.vertex)[used] < 25, -1.0, 1.0)
    assert (np.asarray(after.side)[used] == kept).mean() > 0.95
    forgotten, _ = find_pairs(passed, faces, SETTINGS, 512)
    used = np.asarray(forgotten.side) != 0
    assert (np.asarray(forgotten.side)[used] == np.where(np.asarray(forgotten.vertex)[used] < 25, 1.0, -1.0)).all()
    # And it is pushed back to where it came from.
    gradient, _ = self_contact(jnp.asarray(passed), after, jnp.full(50, 4e-4), LAW, 0.0)
    assert np.asarray(gradient)[25:, 1].sum() < -1e-3


def test_forces_balance_and_follow_the_pressure_law(x64: None) -> None:
    points, faces = two_layers(0.003)
    points += 5e-4 * np.random.default_rng(1).normal(size=points.shape)
    pairs, _ = find_pairs(points, faces, SETTINGS, 512)
    areas = jnp.full(50, 4e-4)
    gradient, _ = jax.jit(self_contact)(jnp.asarray(points), pairs, areas, LAW, 0.0)
    force = -np.asarray(gradient)
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.cross(points, force).sum(axis=0), 0, atol=1e-12)
    assert force[25:, 1].sum() > 0
    # One vertex over the middle of one triangle.
    single = SelfPairs(jnp.array([3]), jnp.array([[0, 1, 2]]), jnp.ones(1), jnp.asarray(0.004))
    x = jnp.array([[0.0, 0, 0], [0.03, 0, 0], [0.0, 0, -0.03], [0.01, 0.001, -0.01]])
    gradient, blocks = self_contact(x, single, jnp.full(4, 2e-4), LAW, 0.0)
    value, slope = pressure(jnp.array([0.003]), jnp.asarray(0.004), LAW)
    np.testing.assert_allclose(gradient[3], [0, -2e-4 * float(value[0]), 0], atol=1e-12)
    np.testing.assert_allclose(np.asarray(gradient)[:3, 1], 2e-4 * float(value[0]) / 3, rtol=1e-9)
    # The diagonal bounds the true matrix w wᵀ from above.
    w = np.array([-1 / 3, -1 / 3, -1 / 3, 1.0])
    bound = np.diag(np.asarray(blocks)[:, 1, 1]) - 2e-4 * float(slope[0]) * np.outer(w, w)
    assert np.linalg.eigvalsh(bound).min() > -1e-9


def test_far_layers_and_padding_feel_nothing(x64: None) -> None:
    points, faces = two_layers(0.006)
    pairs, _ = find_pairs(points, faces, SETTINGS, 512)
    gradient, blocks = self_contact(jnp.asarray(points), pairs, jnp.full(50, 4e-4), LAW, 5e-4)
    assert not np.asarray(gradient).any()
    assert not np.asarray(blocks).any()


@pytest.mark.parametrize("held", [False, True])
def test_a_folded_sheet_rests_on_itself(x64: None, held: bool) -> None:
    """Half of a strip is held in the air, the other half folded over it: without contact it falls through."""
    faces, uv = sheet(14, 3, 0.28, 0.06)
    # Softer cloth folds within one cell, whose neighbours are not kept apart.
    cloth, surface, fabric = make_cloth(faces, uv), slab(), make_fabric(bending=3e-5, warp=300.0, shear=100.0)
    # Around a half circle of 4 cm length, back at a height of its diameter.
    radius, turn = 0.04 / np.pi, np.clip((uv[:, 0] - 0.12) / 0.04, 0, 1) * np.pi
    x = np.where(uv[:, 0] < 0.12, uv[:, 0], 0.12 + radius * np.sin(turn) - np.maximum(uv[:, 0] - 0.16, 0))
    points = np.stack([x, 1.0 + radius * (1 - np.cos(turn)), -uv[:, 1]], axis=1)
    pinned = np.zeros(64, bool)
    pinned[np.flatnonzero(uv[:, 0] < 0.13)] = True
    settings = SolverSettings(linear_tolerance=0.01)
    state: ClothState = start(place(points, cloth), cloth, surface)
    pairs, crossings = None, []
    folding = SelfContact(thickness=0.004)
    still, pins = jnp.zeros_like(surface.vertices), jnp.asarray(pinned)
    goal, piece = jnp.asarray(0.0), jnp.asarray(folding.refresh, jnp.int32)
    for _ in range(25):
        if held:
            pairs, overflow = find_pairs(np.asarray(state.x)[: len(uv)], faces, folding, 2048, pairs)
            assert not overflow
        state, _ = jitted_solve(state, cloth, fabric, surface, settings, still, pins, goal, piece, pairs)
        crossings.append(int(self_intersecting_faces(np.asarray(state.x)[: len(uv)], faces).sum()))
    height = np.asarray(state.x)[: len(uv)][uv[:, 0] > 0.17, 1] - 1.0
    if held:
        assert max(crossings) == 0, crossings
        assert 0.002 < height.min() < 0.005
    else:
        assert max(crossings) > 8, crossings
        assert height.min() < -0.03
