"""How a garment fits: ease at chest, waist and hip, tension of the cloth, and what lies inside the body.

Host side (NumPy); the garment is a finished drape and the body stands in T-pose as when it was draped.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float, Int

from tryon_jax.body.landmarks import GIRTHS, Landmarks
from tryon_jax.body.measurements import measure_vertices
from tryon_jax.contact.push_out import EXACT_BELOW
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.mesh.plane_cut import Curve, cut_mesh, plane_axes
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.stretch import MAX_TENSION, tension_along
from tryon_jax.types import ArrayLike

EASE_AT = ("chest", "waist", "hip")
"""Where ease is measured."""

# Distances up to this, metres, are exact; larger ones, which no report shows, may be a little too large.
_EXACT = 0.03
_measure = jax.jit(measure_vertices)


@dataclass(frozen=True)
class Fit:
    """How one garment fits one body."""

    body_girth: dict[str, float]
    """Girth of the body at each of `EASE_AT`, metres."""
    garment_girth: dict[str, float | None]
    """Length of the cloth round the body at the same height, metres; None where the garment does not go round it."""
    girth_stretch: dict[str, float | None]
    """Length of that cloth over its length in the pattern."""
    pull: dict[str, float]
    """Tension of the cloth along the tape at each of `EASE_AT` that it goes round, N/m; empty without a fabric."""
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
    def too_tight(self) -> list[str]:
        """Where the tension is so large that a real garment could not be put on."""
        return [name for name, pull in self.pull.items() if pull > MAX_TENSION]

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
            if ease is not None and self.pull.get(name, 0.0) >= 1.0:
                text += f", stretched {100 * ((self.girth_stretch[name] or 1) - 1):.1f} % by {self.pull[name]:.0f} N/m"
            lines.append(f"{name:<8} body {body:.1f} cm, garment {text}")
        high = np.quantile(self.tension, 0.95)
        lines.append(f"tension  {100 * high:.1f} % at the 95th percentile, {100 * self.tension.max():.1f} % at most")
        if self.too_tight:
            places = " and ".join(self.too_tight)
            lines.append(
                f"tight    this fabric could hardly be put on at the {places}: more than {MAX_TENSION:g} N/m, where "
                "nothing was learned; take a larger garment or a softer fabric"
            )
        lines.append(f"inside   {100 * self.inside:.2f} % of the vertices, {1000 * self.deepest:.1f} mm at most")
        return lines

    def as_dict(self) -> dict[str, object]:
        """The report as plain numbers (metres and shares), for JSON."""
        return {
            "body_girth": self.body_girth,
            "garment_girth": self.garment_girth,
            "ease": self.ease,
            "girth_stretch": self.girth_stretch,
            "pull": self.pull,
            "too_tight": self.too_tight,
            "tension_95": float(np.quantile(self.tension, 0.95)),
            "tension_max": float(self.tension.max()),
            "vertices_inside": self.inside,
            "deepest_inside": self.deepest,
        }


def measure_fit(
    body: ClosedSurface,
    landmarks: Landmarks,
    vertices: Float[ArrayLike, "V 3"],
    faces: Int[ArrayLike, "F 3"],
    uv: Float[ArrayLike, "U 2"],
    faces_uv: Int[ArrayLike, "F 3"],
    fabric: Fabric | None = None,
    *,
    body_girth: Mapping[str, float] | None = None,
    clearance: Float[np.ndarray, " V"] | None = None,
) -> Fit:
    """Measure a draped garment on a body.

    Args:
        body: the skin of the shaped body in T-pose.
        landmarks: where tapes are laid on it.
        vertices: the draped garment, metres.
        faces: its triangles.
        uv: its pattern, metres.
        faces_uv: entry of `uv` of every face corner.
        fabric: what it is made of, to say how hard it pulls.
        body_girth: girths of the body, metres, where they are known; measured here otherwise.
        clearance: distance of each vertex from the body, metres, negative inside, exact up to `push_out.EXACT_BELOW`,
            where it is known; measured here otherwise.
    """
    points, triangles = np.asarray(vertices, np.float64), np.asarray(faces)
    girth = _measure(body.vertices.astype(np.float32), landmarks) if body_girth is None else body_girth
    # What push-out did not look at so far away.
    rows = np.arange(len(points)) if clearance is None else np.flatnonzero(np.abs(clearance) > EXACT_BELOW)
    clearance = np.zeros(len(points)) if clearance is None else clearance.copy()
    clearance[rows] = body.closest(points[rows], exact_below=_EXACT).distance
    flat, corners = np.asarray(uv, np.float64), np.asarray(faces_uv)
    cloth: dict[str, float | None] = {}
    stretch: dict[str, float | None] = {}
    tapes: dict[str, tuple[float, np.ndarray]] = {}
    for name in EASE_AT:
        loop = loop_round(points, triangles, *tape_place(landmarks, name, body.vertices))
        if loop is None:
            cloth[name] = stretch[name] = None
            continue
        length, natural = loop.length(points[triangles]), loop.length(flat[corners])
        cloth[name], stretch[name] = length, length / natural
        tapes[name] = length / natural, np.abs(np.diff(loop.at(flat[corners]), axis=1)[:, 0]).sum(axis=0)
    strain = stretches(points, triangles, flat, corners)[:, 0] - 1
    total = np.bincount(triangles.ravel(), np.repeat(strain, 3), len(points))
    count = np.bincount(triangles.ravel(), minlength=len(points))
    return Fit(
        body_girth={name: float(girth[name]) for name in EASE_AT},
        garment_girth=cloth,
        girth_stretch=stretch,
        pull={} if fabric is None else _pulls(tapes, fabric),
        clearance=clearance,
        tension=total / np.maximum(count, 1),
    )


def tape_place(
    landmarks: Landmarks, name: str, body_vertices: Float[np.ndarray, "B 3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Where the tape called `name` is laid on a body: the middle of its loop, metres, and the normal of its plane.

    Args:
        landmarks: Of the body.
        name: Of the tape, such as "chest".
        body_vertices: Metres.
    """
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
    """Length of the cloth along `loop_round`, metres, folds and all; None where there is no such loop.

    Args:
        vertices: Of the cloth, metres.
        faces: Its triangles.
        inside: A point inside the limb, metres.
        normal: Unit normal of the plane through it.
    """
    loop = loop_round(vertices, faces, inside, normal)
    return None if loop is None else loop.length(vertices[faces])


def loop_round(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    inside: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
) -> Curve | None:
    """Where the plane through `inside` across `normal` cuts the cloth.

    Of several curves the one that goes round `inside` counts, the longest of those. None where there is none, or where
    it meets an open border, so that the cloth does not go all the way round.

    Args:
        vertices: Of the cloth, metres.
        faces: Its triangles.
        inside: A point inside the limb, metres.
        normal: Unit normal of the plane through it.
    """
    axes = plane_axes(normal)
    corners = vertices[faces]
    closed = [curve for curve in cut_mesh(vertices, faces, inside, normal) if curve.closed]
    round_it = [curve for curve in closed if _goes_round((curve.at(corners) - inside) @ axes.T)]
    return max(round_it, key=lambda curve: curve.length(corners), default=None)


def _pulls(tapes: dict[str, tuple[float, np.ndarray]], fabric: Fabric) -> dict[str, float]:
    """Tension along each tape, N/m, from its stretch and its direction in the pattern; slack cloth has none."""
    found = {}
    for name in EASE_AT:
        # Also where there is no tape or it hangs slack: the first tight garment then finds this compiled.
        stretch, direction = tapes.get(name, (1.0, np.array([1.0, 0.0])))
        unit = direction / np.linalg.norm(direction)
        found[name] = float(max(0.0, tension_along(max(1.0, float(stretch)), unit, fabric.unnamed)))
    return {name: found[name] for name in tapes}


def _goes_round(segments: Float[np.ndarray, "N 2 2"]) -> bool:
    """Whether the closed curve made of `segments`, in any order and direction, goes round the origin.

    A ray from the origin meets a curve that goes round it an odd number of times.
    """
    (ax, ay), (bx, by) = segments[:, 0].T, segments[:, 1].T
    crosses = (ay >= 0) != (by >= 0)
    at = ax[crosses] - ay[crosses] * (bx[crosses] - ax[crosses]) / (by[crosses] - ay[crosses])
    return bool(np.sum(at > 0) % 2)


def stretches(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "U 2"],
    faces_uv: Int[np.ndarray, "F 3"],
) -> Float[np.ndarray, "F 2"]:
    """Largest and smallest principal stretch of each face from its pattern to its drape; 1 is its natural length.

    Args:
        vertices: The drape, metres.
        faces: Its triangles.
        uv: The pattern, metres.
        faces_uv: Entry of `uv` of every face corner.
    """
    (ux, uy), (vx, vy) = _sides(uv[faces_uv])
    first, second = _sides(vertices[faces])
    # Columns of the gradient: where the unit vectors of the pattern go.
    area = ux * vy - uy * vx
    along, across = (first * vy - second * uy) / area, (second * ux - first * vx) / area
    # Singular values in closed form: the roots of a quadratic, the smaller by their product, which is exact.
    aa, bb, ab = (along * along).sum(axis=0), (across * across).sum(axis=0), (along * across).sum(axis=0)
    largest = np.sqrt(0.5 * (aa + bb) + np.hypot(0.5 * (aa - bb), ab))
    product = np.linalg.norm(np.cross(first, second, axis=0), axis=0) / np.abs(area)
    return np.stack([largest, product / np.maximum(largest, 1e-300)], axis=1)


def _sides(corners: Float[np.ndarray, "F 3 c"]) -> tuple[Float[np.ndarray, "c F"], Float[np.ndarray, "c F"]]:
    """The two sides of each triangle that start at its first corner, one row for each coordinate."""
    return (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T


def pattern_of(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "U 2"] | None = None,
    faces_uv: Int[np.ndarray, "F 3"] | None = None,
) -> tuple[Float[np.ndarray, "N 2"], Int[np.ndarray, "F 3"]]:
    """Rest shape of a mesh's triangles in the plane, metres: its `uv` where they are a pattern in true size.

    Texture coordinates are taken for a pattern when their area is that of the mesh to within a quarter; otherwise
    every triangle is laid flat by itself, so that the mesh as it is counts as unstretched.

    Args:
        vertices: Metres.
        faces: Triangles.
        uv: Texture coordinates.
        faces_uv: Entry of `uv` of every face corner.

    Returns:
        Pattern coordinates, metres, and the triangles as indices into them.
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
