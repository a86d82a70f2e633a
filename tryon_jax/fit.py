"""How a garment fits, in the tailor's words: ease at chest, waist and hip, tension of the cloth, and what lies inside.

Host side (NumPy); the garment is a finished drape and the body stands in T-pose as when it was draped.
"""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tryon_jax.body.landmarks import GIRTHS, Landmarks
from tryon_jax.body.measurements import measure_vertices
from tryon_jax.mesh.signed_distance import ClosedSurface
from tryon_jax.types import ArrayLike

EASE_AT = ("chest", "waist", "hip")
"""Where ease is measured."""

# Distances up to this, metres, are exact; those beyond may be a little too large, where nobody asks.
_EXACT = 0.03
_measure = jax.jit(measure_vertices)


@dataclass(frozen=True)
class Fit:
    """How one garment fits one body."""

    body_girth: dict[str, float]
    """Girth of the body at each of `EASE_AT`, metres."""
    garment_girth: dict[str, float | None]
    """Length of the cloth round the body at the same height, metres; None where the garment does not go round it."""
    clearance: Float[np.ndarray, " V"]
    """Distance of each vertex from the body, metres; negative inside."""
    tension: Float[np.ndarray, " V"]
    """Largest principal strain of the cloth around each vertex: 0.1 is cloth pulled 10 % longer than the pattern."""

    @property
    def ease(self) -> dict[str, float | None]:
        """Garment's minus body's girth, metres; negative where the cloth is stretched round the body."""
        pairs = {name: (self.garment_girth[name], girth) for name, girth in self.body_girth.items()}
        return {name: None if cloth is None else cloth - girth for name, (cloth, girth) in pairs.items()}

    @property
    def inside(self) -> float:
        """Share of the vertices that lie inside the body."""
        return float(np.mean(self.clearance < 0))

    @property
    def deepest(self) -> float:
        """How far the deepest vertex lies inside the body, metres; 0 when none does."""
        return float(max(0.0, -self.clearance.min()))

    def lines(self) -> list[str]:
        """The report in words, one line each."""
        lines = []
        for name, ease in self.ease.items():
            body = 100 * self.body_girth[name]
            cloth = self.garment_girth[name]
            text = (
                "not covered" if ease is None or cloth is None else f"{100 * cloth:.1f} cm, ease {100 * ease:+.1f} cm"
            )
            lines.append(f"{name:<8} body {body:.1f} cm, garment {text}")
        high = np.quantile(self.tension, 0.95)
        lines.append(f"tension  {100 * high:.1f} % at the 95th percentile, {100 * self.tension.max():.1f} % at most")
        lines.append(f"inside   {100 * self.inside:.2f} % of the vertices, {1000 * self.deepest:.1f} mm at most")
        return lines

    def as_dict(self) -> dict[str, object]:
        """The report as plain numbers (metres and shares), for JSON."""
        return {
            "body_girth": self.body_girth,
            "garment_girth": self.garment_girth,
            "ease": self.ease,
            "tension_95": float(np.quantile(self.tension, 0.95)),
            "tension_max": float(self.tension.max()),
            "vertices_inside": self.inside,
            "deepest_inside": self.deepest,
        }


def measure_fit(
    body_vertices: Float[ArrayLike, "B 3"],
    body_faces: Int[ArrayLike, "G 3"],
    landmarks: Landmarks,
    vertices: Float[ArrayLike, "V 3"],
    faces: Int[ArrayLike, "F 3"],
    uv: Float[ArrayLike, "U 2"],
    faces_uv: Int[ArrayLike, "F 3"],
) -> Fit:
    """Measure a draped garment on a body.

    Args:
        body_vertices: the shaped body in T-pose, metres.
        body_faces: its triangles; the body must be closed.
        landmarks: where tapes are laid on it.
        vertices: the draped garment, metres.
        faces: its triangles.
        uv: its pattern, metres.
        faces_uv: entry of `uv` of every face corner.
    """
    body_points = np.asarray(body_vertices, np.float64)
    points, triangles = np.asarray(vertices, np.float64), np.asarray(faces)
    surface = ClosedSurface(body_points, np.asarray(body_faces))
    measured = _measure(body_vertices, landmarks)
    cloth: dict[str, float | None] = {}
    for name in EASE_AT:
        middle, normal = tape_place(landmarks, name, body_points)
        cloth[name] = girth_round(points, triangles, middle, normal)
    strain = stretches(points, triangles, np.asarray(uv, np.float64), np.asarray(faces_uv))[:, 0] - 1
    total = np.bincount(triangles.ravel(), np.repeat(strain, 3), len(points))
    count = np.bincount(triangles.ravel(), minlength=len(points))
    return Fit(
        body_girth={name: float(measured[name]) for name in EASE_AT},
        garment_girth=cloth,
        clearance=surface.closest(points, exact_below=_EXACT)[0],
        tension=total / np.maximum(count, 1),
    )


def tape_place(
    landmarks: Landmarks, name: str, body_vertices: Float[np.ndarray, "B 3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Where the tape called `name` is laid on a body: the middle of its loop, metres, and the normal of its plane."""
    row = GIRTHS.index(name)
    loop = body_vertices[np.asarray(landmarks.loop_index)[row]]
    middle = np.asarray(landmarks.loop_weight)[row].astype(np.float64) @ loop
    return middle, np.asarray(landmarks.normal)[row].astype(np.float64)


def girth_round(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    inside: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
) -> float | None:
    """Length of the cloth where the plane through `inside` across `normal` cuts it, metres, folds and all.

    Of several curves the one that goes round `inside` counts. None where there is none, or where it meets an open
    border, so that the cloth does not go all the way round.
    """
    height = (vertices - inside) @ normal
    above = height >= 0
    face, corner = np.nonzero(above[faces] != above[np.roll(faces, -1, axis=1)])
    if not len(face):
        return None
    # Every face that is cut has two cut edges, side by side in this list.
    ends = np.sort(np.stack([faces[face, corner], faces[face, (corner + 1) % 3]], axis=1), axis=1)
    edges, index, uses = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    low, high = height[edges[:, 0]], height[edges[:, 1]]
    fraction = (low / (low - high))[:, None]
    points = vertices[edges[:, 0]] * (1 - fraction) + vertices[edges[:, 1]] * fraction
    segments = index.reshape(-1, 2)
    links = coo_array((np.ones(len(segments)), (segments[:, 0], segments[:, 1])), shape=(len(edges), len(edges)))
    count, label = connected_components(links, directed=False)
    start = np.eye(3)[np.argmin(np.abs(normal))]
    across = np.cross(normal, start)
    axes = np.stack([across, np.cross(normal, across)], axis=1)
    flat = (points - inside) @ axes
    best = None
    for curve in range(count):
        own = label[segments[:, 0]] == curve
        if (uses[label == curve] == 2).all() and abs(_turns(flat[segments[own]])) > 0.5:
            length = np.linalg.norm(np.diff(points[segments[own]], axis=1), axis=-1).sum()
            best = max(best or 0.0, float(length))
    return best


def _turns(segments: Float[np.ndarray, "N 2 2"]) -> float:
    """How often the closed curve made of `segments` (in any order and direction) goes round the origin, up to sign.

    A ray from the origin meets a curve that goes round it an odd number of times.
    """
    (ax, ay), (bx, by) = segments[:, 0].T, segments[:, 1].T
    crosses = (ay >= 0) != (by >= 0)
    at = ax[crosses] - ay[crosses] * (bx[crosses] - ax[crosses]) / (by[crosses] - ay[crosses])
    return float(np.sum(at > 0) % 2)


def stretches(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "U 2"],
    faces_uv: Int[np.ndarray, "F 3"],
) -> Float[np.ndarray, "F 2"]:
    """Largest and smallest principal stretch of each face from its pattern to its drape; 1 is its natural length."""
    flat = uv[faces_uv]
    rest = np.stack([flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]], axis=2)
    corners = vertices[faces]
    now = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    gradient = now @ np.linalg.inv(rest)
    return np.linalg.svd(gradient, compute_uv=False)


def pattern_of(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "U 2"] | None = None,
    faces_uv: Int[np.ndarray, "F 3"] | None = None,
) -> tuple[Float[np.ndarray, "N 2"], Int[np.ndarray, "F 3"]]:
    """Rest shape of a mesh's triangles in the plane, metres: its `uv` where they are a pattern in true size.

    Texture coordinates are taken for a pattern when their area is that of the mesh to within a quarter; otherwise
    every triangle is laid flat by itself, so that the mesh as it is counts as unstretched.
    """
    corners = vertices[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    if uv is not None and faces_uv is not None:
        flat = uv[faces_uv]
        a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
        doubled = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        drawn, real = doubled.sum(), np.linalg.norm(np.cross(first, second), axis=1).sum()
        if abs(drawn / real - 1) < 0.25 and doubled.min() > 0:
            return uv, faces_uv
    length = np.linalg.norm(first, axis=1)
    along = np.sum(first * second, axis=1) / length
    across = np.sqrt(np.maximum(np.sum(second**2, axis=1) - along**2, 0))
    zero = np.zeros_like(length)
    laid = np.stack([zero, zero, length, zero, along, across], axis=1).reshape(-1, 2)
    return laid, np.arange(3 * len(faces)).reshape(-1, 3)
