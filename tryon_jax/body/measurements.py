"""Measurements of a body, as for clothes, differentiable in its shape."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tryon_jax.body.landmarks import GIRTHS, POINTS, Landmarks, load_landmarks
from tryon_jax.body.shape import shape_body
from tryon_jax.checks import check_choice, check_range
from tryon_jax.types import EXACT, ArrayLike, Body


@dataclass(frozen=True)
class Measurement:
    """What one measurement is."""

    standard: str
    """Its name in ISO 8559-1:2017."""
    low: float
    """Smallest value that an adult may have, metres."""
    high: float
    """Greatest such value, metres."""


MEASUREMENTS = {
    "stature": Measurement("stature", 1.2, 2.3),
    "chest": Measurement("bust girth, chest girth", 0.6, 1.8),
    "waist": Measurement("waist girth", 0.4, 1.8),
    "hip": Measurement("hip girth", 0.6, 1.8),
    "neck": Measurement("neck girth", 0.2, 0.7),
    "upper_arm": Measurement("upper-arm girth", 0.12, 0.7),
    "arm_length": Measurement("arm length", 0.35, 0.9),
    "inside_leg": Measurement("inside leg height", 0.5, 1.2),
    "shoulder_width": Measurement("shoulder width", 0.2, 0.6),
}
"""Names of the measurements and what they are."""

# At two degrees a perimeter is right to 0.1 mm per metre.
_DIRECTIONS = 180


def check_measurement(name: str, value: float) -> float:
    """`value` in metres, or `ValueError` naming the range; values that look like cm, mm or inches are told so."""
    check_choice("measurement", name, MEASUREMENTS)
    low, high = MEASUREMENTS[name].low, MEASUREMENTS[name].high
    return check_range(name, value, low, high, "m")


def tape_girth(
    vertices: Float[Array, "V 3"], edges: Int[ArrayLike, "E 2"], level: Float[Array, ""], normal: Float[ArrayLike, "3"]
) -> Float[Array, ""]:
    """Length of a taut tape, metres, laid in the plane {x : normal · x = level} around the limb that has `edges`.

    The tape is the convex hull of the points where the plane cuts the edges. By Cauchy's formula its perimeter is the
    integral of the support function over all directions, and the support of a hull is a maximum over the points: no
    hull is built, no order is needed, and gradients pass.

    Args:
        vertices: Vertices of the body, metres.
        edges: Edges of the mesh that the tape crosses.
        level: Offset of the plane along `normal`, metres.
        normal: Unit normal of the plane.
    """
    normal = jnp.asarray(normal, vertices.dtype)
    ends = vertices[jnp.asarray(edges)]
    height = jnp.matmul(ends, normal, precision=EXACT) - level
    low, high = height[:, 0], height[:, 1]
    cut = (low >= 0) != (high >= 0)
    fraction = low / jnp.where(cut, low - high, 1)
    points = ends[:, 0] + fraction[:, None] * (ends[:, 1] - ends[:, 0])

    start = jnp.eye(3, dtype=vertices.dtype)[jnp.argmin(jnp.abs(normal))]
    first = jnp.cross(normal, start)
    first = first / jnp.linalg.norm(first)
    axes = jnp.stack([first, jnp.cross(normal, first)], axis=1)
    # Rounding is least around the limb's own middle.
    flat = jnp.matmul(points - jnp.mean(ends, axis=(0, 1))[None], axes, precision=EXACT)
    angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    turn = jnp.asarray(np.stack([np.cos(angle), np.sin(angle)]), vertices.dtype)
    reach = jnp.where(cut[:, None], jnp.matmul(flat, turn, precision=EXACT), -jnp.inf)
    # Taking the touching points first spares derivatives of all the others.
    touching = flat[jnp.argmax(jax.lax.stop_gradient(reach), axis=0)]
    return jnp.mean(jnp.sum(touching * turn.T, axis=1)) * (2 * np.pi)


def measure_vertices(vertices: Float[ArrayLike, "V 3"], landmarks: Landmarks) -> dict[str, Float[Array, ""]]:
    """All `MEASUREMENTS` of a T-posed body with these vertices, metres. Pure: jit, grad and `vmap`."""
    vertices = jnp.asarray(vertices)
    height = vertices[:, 1]
    points = jnp.sum(vertices[jnp.asarray(landmarks.point_index)] * landmarks.point_weight[:, :, None], axis=1)
    at: dict[str, Array] = dict(zip(POINTS, points, strict=True))
    middles = jnp.sum(vertices[jnp.asarray(landmarks.loop_index)] * landmarks.loop_weight[:, :, None], axis=1)
    normals = jnp.asarray(landmarks.normal, vertices.dtype)
    levels = jnp.sum(middles * normals, axis=1)
    girths = jax.vmap(tape_girth, in_axes=(None, 0, 0, 0))(vertices, jnp.asarray(landmarks.edges), levels, normals)

    def distance(start: str, end: str) -> Float[Array, ""]:
        return jnp.linalg.norm(at[start] - at[end])

    return {
        "stature": jnp.max(height) - jnp.min(height),
        **dict(zip(GIRTHS, girths, strict=True)),
        "arm_length": distance("shoulder_left", "elbow") + distance("elbow", "wrist"),
        "inside_leg": at["crotch"][1] - jnp.min(height),
        "shoulder_width": distance("shoulder_left", "shoulder_right"),
    }


def measure_body(
    body: Body, betas: Float[ArrayLike, " b"], landmarks: Landmarks | None = None
) -> dict[str, Float[Array, ""]]:
    """All `MEASUREMENTS` of `body` with shape `betas`, metres, by name. Pure: jit, grad and `vmap`.

    Girths are those of a taut tape in a plane whose height is fixed to the skin (see `find_landmarks`). The body
    stands in T-pose: raised arms bring the shoulder points closer together and widen the chest a little towards the
    armpits, so `shoulder_width` and `chest` are not quite those of a person with hanging arms. The forearms of the
    embedded bodies are somewhat short. `landmarks` are those of the body unless given; a body from a file that is
    traced by JAX needs them.

    Args:
        body: The body.
        betas: Its shape, standard deviations.
        landmarks: Of the body; found on it when None. A body from a file that is traced by JAX needs them.
    """
    landmarks = load_landmarks(body) if landmarks is None else landmarks
    return measure_vertices(shape_body(body, betas)[0], jax.tree.map(jnp.asarray, landmarks))
