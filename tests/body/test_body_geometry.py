"""Random bodies are sound meshes: closed, turned outward, no face folded over, and where they touch themselves."""

import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.body import face_normals, load_body, shape_body
from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.types import Body

NAMES = ("female", "male", "neutral")
# Four faces of the groin in some bodies; the neutral body is no person at its extremes.
INVERTED = {"female": 4, "male": 4, "neutral": 80}
CROSSING = {"female": 11, "male": 4, "neutral": 20}
BODIES = {name: load_body(name) for name in NAMES}


def random_vertices(body: Body, count: int) -> np.ndarray:
    """Bodies with betas uniform in -2 to 2 [count, V, 3]."""
    betas = np.random.default_rng(0).uniform(-2, 2, (count, 10))
    directions = np.moveaxis(np.asarray(body.shapedirs, np.float64), 2, 0)
    return np.asarray(body.v_template, np.float64) + np.tensordot(betas, directions, 1)


def where(body: Body, marked: np.ndarray) -> dict[str, int]:
    """Number of marked faces at each joint."""
    joint = np.asarray(body.lbs_weights)[np.asarray(body.faces)[marked]].mean(axis=1).argmax(axis=1)
    return {body.joint_names[j]: int((joint == j).sum()) for j in np.unique(joint)}


@pytest.mark.parametrize("name", NAMES)
def test_two_hundred_bodies_are_outward_and_unfolded(name: str) -> None:
    body = BODIES[name]
    faces = np.asarray(body.faces)
    mean = np.asarray(face_normals(body.v_template, body.faces), np.float64)
    volumes, turned, places = [], [], np.zeros(len(faces), int)
    for vertices in random_vertices(body, 200):
        a, b, c = vertices[faces].swapaxes(0, 1)
        area = np.cross(b - a, c - a)
        volumes.append(np.einsum("fd,fd->", area, a) / 6)
        against = np.einsum("fd,fd->f", area, mean) <= 0
        turned.append(int(against.sum()))
        places += against
    print(
        f"{name}: volume {1e3 * min(volumes):.0f} to {1e3 * max(volumes):.0f} litres; faces turned by more than 90 "
        f"degrees from the mean body's: {sum(turned)} in {np.count_nonzero(turned)} bodies, at most {max(turned)} in "
        f"one, at {where(body, places > 0)}"
    )
    assert min(volumes) > 0.025
    assert max(volumes) < 0.16
    assert max(turned) <= INVERTED[name]


@pytest.mark.parametrize("name", ["female", "male"])
def test_stature_alone_makes_no_body_cross_itself(name: str) -> None:
    body = BODIES[name]
    for beta in (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0):
        vertices, _ = shape_body(body, jnp.asarray([beta]))
        assert not self_intersecting_faces(np.asarray(vertices), np.asarray(body.faces)).any(), f"beta 1 = {beta}"


@pytest.mark.parametrize(
    ("name", "betas", "place"),
    [
        ("female", (0, -3), {"L_hip", "R_hip", "pelvis"}),  # heavy thighs in contact
        ("female", (0, 3), {"L_hip", "R_hip", "pelvis"}),  # the groin of a very lean body
        ("neutral", (-3,), {"L_hip", "R_hip", "L_knee", "R_knee"}),
    ],
)
def test_known_bodies_that_cross_themselves(name: str, betas: tuple[float, ...], place: set[str]) -> None:
    """The docstring of `load_body` names them; when one of these passes unnoticed the count is broken."""
    body = BODIES[name]
    vertices, _ = shape_body(body, jnp.asarray(betas, jnp.float32))
    found = where(body, self_intersecting_faces(np.asarray(vertices), np.asarray(body.faces)))
    print(name, betas, found)
    assert 0 < sum(found.values()) < 100
    assert set(found) <= place


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_two_hundred_bodies_cross_themselves_rarely(name: str) -> None:
    body = BODIES[name]
    crossing = {}
    for number, vertices in enumerate(random_vertices(body, 200)):
        marked = self_intersecting_faces(vertices, np.asarray(body.faces))
        if marked.any():
            crossing[number] = where(body, marked)
    print(f"{name}: {len(crossing)} of 200 bodies cross themselves: {crossing}")
    joints = {joint for found in crossing.values() for joint in found}
    if name != "neutral":
        assert joints <= {"pelvis", "L_hip", "R_hip"}  # inner thighs and groin, never the armpits
    assert len(crossing) <= CROSSING[name]
