"""Measurements against plane slices, against bodies of known size, and back from measurements to bodies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from tryon_jax.body import (
    MEASUREMENTS,
    Landmarks,
    betas_from_measurements,
    find_landmarks,
    load_body,
    measure_body,
    shape_body,
)
from tryon_jax.body.landmarks import GIRTHS, load_landmarks
from tryon_jax.body.measurements import tape_girth
from tryon_jax.types import Body

NAMES = ("female", "male", "neutral")
BODIES = {name: load_body(name) for name in NAMES}
LANDMARKS = {name: jax.tree.map(jnp.asarray, load_landmarks(body)) for name, body in BODIES.items()}
measure = jax.jit(measure_body)


def random_betas(count: int, seed: int, limit: float = 2.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-limit, limit, (count, 10)).astype(np.float32)


def sliced_girth(vertices: np.ndarray, faces: np.ndarray, name: str, level: float, normal: np.ndarray) -> float:
    """Perimeter of the hull of the slice through the limb that the tape is around, by trimesh."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    lines = trimesh.intersections.mesh_plane(mesh, plane_normal=normal, plane_origin=level * normal)
    ends, index = np.unique(lines.reshape(-1, 3).round(8), axis=0, return_inverse=True)
    pairs = index.reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(ends), len(ends)))
    count, label = connected_components(graph, directed=False)
    girths = []
    for curve in (ends[label == k] for k in range(count)):
        middle = 0.5 * (curve.min(axis=0) + curve.max(axis=0))
        on_limb = middle[0] > 0.05 if name == "upper_arm" else np.abs(middle[0]) < 0.05
        if on_limb and len(curve) > 8:
            flat = curve @ trimesh.geometry.align_vectors(normal, [0, 0, 1])[:3, :3].T
            girths.append(ConvexHull(flat[:, :2]).area)
    return max(girths)


@pytest.mark.parametrize("name", NAMES)
def test_girths_agree_with_plane_slices(name: str) -> None:
    body, marks = BODIES[name], LANDMARKS[name]
    faces = np.asarray(body.faces)
    worst = dict.fromkeys(GIRTHS, 0.0)
    for betas in random_betas(100 if name == "female" else 30, 7):
        measured = measure(body, jnp.asarray(betas), marks)
        vertices = np.asarray(shape_body(body, jnp.asarray(betas))[0], np.float64)
        for row, girth in enumerate(GIRTHS):
            normal = np.asarray(marks.normal[row], np.float64)
            middle = (vertices[marks.loop_index[row]] * np.asarray(marks.loop_weight[row])[:, None]).sum(axis=0)
            sliced = sliced_girth(vertices, faces, girth, float(middle @ normal), normal)
            worst[girth] = max(worst[girth], abs(float(measured[girth]) - sliced))
    print(name, {girth: f"{1e3 * error:.3f} mm" for girth, error in worst.items()})
    assert max(worst.values()) < 5e-3


def test_a_cylinder_has_the_girth_of_its_circle(x64: None) -> None:
    tube = trimesh.creation.cylinder(radius=0.15, height=1.0, sections=400)
    edges = jnp.asarray(tube.edges_unique)
    tilted = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
    straight = tape_girth(jnp.asarray(tube.vertices), edges, jnp.asarray(0.1), jnp.asarray([0.0, 0, 1]))
    assert float(straight) == pytest.approx(2 * np.pi * 0.15, rel=1e-4)
    # Cut at a slant, the circle is an ellipse with one axis longer by the secant of the angle.
    long, short = 0.15 / tilted[2], 0.15
    angle = (np.arange(10**5) + 0.5) * 2 * np.pi / 10**5
    ellipse = np.hypot(long * np.sin(angle), short * np.cos(angle)).mean() * 2 * np.pi
    slanted = tape_girth(jnp.asarray(tube.vertices), edges, jnp.asarray(0.0), jnp.asarray(tilted))
    assert float(slanted) == pytest.approx(ellipse, rel=1e-4)


def test_a_tape_spans_hollows() -> None:
    bar = trimesh.creation.box([0.2, 0.1, 1.0])
    post = trimesh.util.concatenate([bar, bar.copy().apply_translation([0.4, 0, 0])])
    girth = tape_girth(
        jnp.asarray(post.vertices, jnp.float32),
        jnp.asarray(post.edges_unique),
        jnp.asarray(0.01),
        jnp.asarray([0, 0, 1.0]),
    )
    assert float(girth) == pytest.approx(2 * (0.6 + 0.1), rel=2e-4)


@pytest.mark.parametrize("name", NAMES)
def test_mean_bodies_measure_as_adults(name: str) -> None:
    measured = {key: float(value) for key, value in measure(BODIES[name], jnp.zeros(10), LANDMARKS[name]).items()}
    print(name, {key: round(value, 3) for key, value in measured.items()})
    assert set(measured) == set(MEASUREMENTS)
    for key, value in measured.items():
        assert MEASUREMENTS[key].low < value < MEASUREMENTS[key].high
    assert measured["waist"] < measured["chest"]
    assert measured["waist"] < measured["hip"]
    assert 0.4 < measured["inside_leg"] / measured["stature"] < 0.5
    assert 0.25 < measured["arm_length"] / measured["stature"] < 0.36
    vertices = np.asarray(shape_body(BODIES[name], jnp.zeros(10))[0])
    assert measured["stature"] == pytest.approx(np.ptp(vertices[:, 1]), abs=1e-6)


def test_landmarks_in_the_file_are_those_that_are_found() -> None:
    for name, body in BODIES.items():
        found, stored = find_landmarks(body), load_landmarks(body)
        vertices = np.asarray(body.v_template)

        def places(marks: Landmarks, vertices: np.ndarray = vertices) -> list[np.ndarray]:
            loops = (vertices[marks.loop_index] * marks.loop_weight[:, :, None]).sum(axis=1)
            return [loops, (vertices[marks.point_index] * marks.point_weight[:, :, None]).sum(axis=1), marks.normal]

        for mine, its in zip(places(found), places(stored), strict=True):
            np.testing.assert_allclose(mine, its, atol=1e-4, err_msg=name)
        for mine, its in zip(found.edges, stored.edges, strict=True):
            assert {tuple(edge) for edge in mine.tolist()} == {tuple(edge) for edge in its.tolist()}


def test_gradients_agree_with_differences(x64: None) -> None:
    body = jax.tree.map(lambda leaf: leaf.astype(float) if leaf.dtype == jnp.float32 else leaf, BODIES["female"])
    marks = LANDMARKS["female"]
    betas = jnp.asarray([0.4, -0.7, 0.3, 0.9, -0.2, 0.5, 0.1, -0.6, 0.8, 0.25])
    slope = jax.jit(jax.jacfwd(measure_body, argnums=1))(body, betas, marks)
    step = 1e-6
    moved = betas[None] + step * jnp.concatenate([jnp.eye(10), -jnp.eye(10)])
    around = jax.jit(jax.vmap(measure_body, in_axes=(None, 0, None)))(body, moved, marks)
    for name in MEASUREMENTS:
        differences = (around[name][:10] - around[name][10:]) / (2 * step)
        # Where a point of the tape changes place the slope jumps a little: compare to 0.1 mm per unit.
        np.testing.assert_allclose(slope[name], differences, atol=1e-4, err_msg=name)


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("female", tuple(MEASUREMENTS)),
        ("female", ("stature", "chest")),
        ("male", ("stature", "chest", "waist", "hip")),
        ("female", ("inside_leg", "upper_arm", "neck")),
    ],
)
def test_random_bodies_are_recovered(name: str, asked: tuple[str, ...]) -> None:
    worst = dict.fromkeys(asked, 0.0)
    for betas in random_betas(6, 11):
        measured = measure(BODIES[name], jnp.asarray(betas), LANDMARKS[name])
        fit = betas_from_measurements(BODIES[name], {key: float(measured[key]) for key in asked})
        assert fit.outside is None
        assert set(fit.residuals) == set(asked)
        again = measure(BODIES[name], fit.betas, LANDMARKS[name])
        for key in asked:
            assert fit.residuals[key] == pytest.approx(float(again[key] - measured[key]), abs=1e-5)
            worst[key] = max(worst[key], abs(float(again[key] - measured[key])))
    print(name, {key: f"{1e3 * error:.2f} mm" for key, error in worst.items()})
    assert max(worst.values()) < 5e-3


def test_what_is_left_open_stays_average() -> None:
    fit = betas_from_measurements(BODIES["female"], {"stature": 1.72})
    assert fit.measured["stature"] == pytest.approx(1.72, abs=1e-3)
    assert float(fit.betas[0]) == pytest.approx(1.4, abs=0.2)
    assert float(jnp.abs(fit.betas[1:]).max()) < 0.2


def test_a_body_that_cannot_be_is_said_to_be_one() -> None:
    fit = betas_from_measurements(BODIES["female"], {"stature": 1.72, "waist": 1.2, "hip": 0.8})
    assert fit.outside is not None
    assert "'female' cannot have these measurements together: " in fit.outside
    assert "waist 1.200 m missed by -" in fit.outside
    assert "edge of its range" in fit.outside
    assert float(jnp.abs(fit.betas).max()) < 3.2


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"stature": 172}, r"stature = 172 m is outside its range 1.2 to 2.3 m; 172 looks like centimetres: give 1.72"),
        ({"waist": 780}, "780 looks like millimetres: give 0.78"),
        ({"chest": 38}, "38 looks like inches: give 0.965"),
        ({"hip": -1.0}, r"hip = -1 m is outside its range 0.6 to 1.8 m$"),
        ({"hip": float("nan")}, "hip must be finite"),
        ({"hight": 1.7}, "unknown measurement 'hight'"),
        ({"wasit": 0.7}, "did you mean 'waist'"),
        ({}, "at least one measurement"),
    ],
)
def test_bad_measurements_are_refused(request_: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        betas_from_measurements(BODIES["female"], request_)


def test_other_bodies_find_their_own_landmarks() -> None:
    embedded = BODIES["male"]
    body = Body(**{**vars(embedded), "name": "my_own"})
    mine, its = measure_body(body, jnp.ones(3)), measure_body(embedded, jnp.ones(3))
    for key in MEASUREMENTS:
        assert float(mine[key]) == pytest.approx(float(its[key]), abs=2e-4)
    with pytest.raises(ValueError, match="is traced: call find_landmarks"):
        jax.jit(measure_body)(body, jnp.ones(3))
    nameless = Body(**{**vars(embedded), "name": "x", "joint_names": ("a",) * 24})
    with pytest.raises(ValueError, match="no joint 'L_hip'"):
        measure_body(nameless, jnp.ones(3))
