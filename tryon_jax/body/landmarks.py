"""Landmarks of a body: where girths and lengths are measured, found once on the mean body (host side).

A place is fixed to the skin, as a weighted sum of vertices, and moves with it when the shape changes. A tape is laid
level at the mean height of the loop where it lay on the mean body, around the mesh edges of its limb: the loop's own
skin tilts with the shape by up to 5 cm, a tape does not. Levels follow ISO 8559-1 as far as a body in T-pose allows.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tryon_jax.body.embedded import NAMES, NUM_VERTICES, read_asset
from tryon_jax.mesh.plane_cut import cut_mesh, plane_axes, tape_length
from tryon_jax.mesh.topology import unique_edges
from tryon_jax.types import ArrayLike, Body, pytree

GIRTHS = ("chest", "waist", "hip", "neck", "upper_arm")
"""Places of tapes, in the order of the rows of `Landmarks`."""
POINTS = ("shoulder_left", "shoulder_right", "elbow", "wrist", "crotch")
"""Places of single points, in the order of the rows of `Landmarks`."""
UP = np.array([0.0, 1.0, 0.0])
_REACH = {"chest": 0.1, "waist": 0.1, "hip": 0.1, "neck": 0.03, "upper_arm": 0.05}
# Metres to either side of the loop within which a tape may come to lie when the shape changes.


@pytree
class Landmarks:
    """Where the tapes of `GIRTHS` and the points of `POINTS` lie on one body."""

    loop_index: Int[ArrayLike, "G N"]
    """Vertices around each tape's place; rows of unequal length are filled up with weight 0."""
    loop_weight: Float[ArrayLike, "G N"]
    """Their weights in the mean of the loop; rows sum to 1."""
    normal: Float[ArrayLike, "G 3"]
    """Unit normal of the plane of each tape."""
    edges: Int[ArrayLike, "G E 2"]
    """Mesh edges that each tape may cross: those of its limb, near the loop; filled up by repeating one."""
    point_index: Int[ArrayLike, "P 3"]
    """Three vertices around each point."""
    point_weight: Float[ArrayLike, "P 3"]
    """Their weights; rows sum to 1."""


def load_landmarks(body: Body) -> Landmarks:
    """The landmarks of an embedded body, from its file; of any other body, found on its mean shape.

    Raises `ValueError` when they would have to be found while `body` is traced by JAX, or when they are not found.
    """
    if body.name in NAMES and body.v_template.shape[0] == NUM_VERTICES:
        keys = {field.name: f"landmark_{field.name}" for field in dataclasses.fields(Landmarks)}
        arrays = read_asset(body.name, keys.values())
        return Landmarks(**{name: arrays[key] for name, key in keys.items()})
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(body)):
        raise ValueError(f"body {body.name!r} is traced: call find_landmarks(body) outside and hand the result in")
    return find_landmarks(body)


def find_landmarks(body: Body) -> Landmarks:
    """Landmarks on the mean shape of a body in T-pose with SMPL's first 22 joints.

    Levels are fractions of the way from the hip joints up to the neck joint: chest at the fullest point in front
    between 0.56 and 0.64, waist where the girth is least between 0.25 and 0.55, hip where it is greatest between -0.15
    and 0.1. The neck is taken where it is thinnest, across the line from neck to head, the upper arm half way from
    shoulder to elbow. Shoulder points lie straight above the shoulder joints, elbow and wrist points straight behind
    theirs, the crotch is the lowest point of the middle of the trunk.

    Raises `ValueError` when the body lacks a joint or a landmark is not found.
    """
    mesh = _Mesh(body)
    shoulder, elbow = mesh.joint("L_shoulder"), mesh.joint("L_elbow")
    along = (elbow - shoulder) / np.linalg.norm(elbow - shoulder)
    neck, neck_axis = mesh.thinnest_neck()
    loops = {
        "chest": (mesh.horizontal(mesh.fullest_front(0.56, 0.64)), UP),
        "waist": (mesh.extreme_level(0.25, 0.55, -1), UP),
        "hip": (mesh.extreme_level(-0.15, 0.1, 1), UP),
        "neck": (neck, neck_axis),
        "upper_arm": (mesh.around("upper_arm", 0.5 * (shoulder + elbow), along), along),
    }
    index, weight = zip(*(_mean_of(loops[name][0]) for name in GIRTHS), strict=True)
    edges = [mesh.band(name, *loops[name]) for name in GIRTHS]

    behind = np.array([0.0, 0.0, -1.0])
    points = {
        "shoulder_left": mesh.surface_point("shoulder", shoulder, UP),
        "shoulder_right": mesh.surface_point("shoulder", mesh.joint("R_shoulder"), UP),
        "elbow": mesh.surface_point("elbow", elbow, behind),
        "wrist": mesh.surface_point("wrist", mesh.joint("L_wrist"), behind),
        "crotch": mesh.crotch(),
    }
    return Landmarks(
        loop_index=_filled(index, 0).astype(np.int32),
        loop_weight=_filled(weight, 0).astype(np.float32),
        normal=np.stack([loops[name][1] for name in GIRTHS]).astype(np.float32),
        edges=_filled(edges, None).astype(np.int32),
        point_index=np.stack([points[name][0] for name in POINTS]).astype(np.int32),
        point_weight=np.stack([points[name][1] for name in POINTS]).astype(np.float32),
    )


class _Outline(NamedTuple):
    """One closed curve round a limb, as points on mesh edges in no particular order."""

    edges: Int[np.ndarray, "N 2"]
    """Vertices at the ends of the cut edges."""
    fraction: Float[np.ndarray, " N"]
    """Where each edge is cut: 0 at its first end, 1 at its second."""
    points: Float[np.ndarray, "N 3"]
    """The cut points, metres."""


def _mean_of(outline: _Outline) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and weights whose sum is the mean of a loop's points."""
    share = np.stack([1 - outline.fraction, outline.fraction], axis=1) / len(outline.points)
    index, place = np.unique(outline.edges, return_inverse=True)
    return index, np.bincount(place.ravel(), share.ravel())


def _filled(rows: Sequence[np.ndarray], value: int | None) -> np.ndarray:
    """Rows of unequal length as one array, filled up with `value` or, for None, with their own first entry."""
    length = max(len(row) for row in rows)
    spare = [row[:1] if value is None else np.full_like(row[:1], value) for row in rows]
    return np.stack([np.concatenate([row, *[one] * (length - len(row))]) for row, one in zip(rows, spare, strict=True)])


class _Mesh:
    """The mean body with what the search asks of it."""

    def __init__(self, body: Body) -> None:
        self.name = body.name
        self.names = body.joint_names
        self.vertices = np.asarray(body.v_template, np.float64)
        self.faces = np.asarray(body.faces, np.int64)
        self.joints = np.asarray(body.J_regressor, np.float64) @ self.vertices
        self.weights = np.asarray(body.lbs_weights, np.float64)
        self.hip = 0.5 * (self.joint("L_hip")[1] + self.joint("R_hip")[1])
        self.reach = self.joint("neck")[1] - self.hip

    def joint(self, name: str) -> np.ndarray:
        if name not in self.names:
            raise ValueError(f"body {self.name!r} has no joint {name!r}, so it cannot be measured")
        return self.joints[self.names.index(name)]

    def level(self, fraction: float) -> float:
        return self.hip + fraction * self.reach

    def around(self, name: str, point: np.ndarray, across: np.ndarray) -> _Outline:
        """The largest of the curves across a limb whose bounding box in their plane holds `point`."""
        axes = plane_axes(across)
        centre = axes @ point
        found = []
        for outline in self.outlines(point, across):
            flat = outline.points @ axes.T
            if len(flat) > 3 and (flat.min(axis=0) < centre).all() and (flat.max(axis=0) > centre).all():
                found.append(outline)
        if not found:
            raise ValueError(f"body {self.name!r}: no closed curve around the {name} landmark at {point.round(3)}")
        return max(found, key=lambda outline: tape_length(outline.points, across))

    def outlines(self, point: np.ndarray, across: np.ndarray) -> list[_Outline]:
        curves = cut_mesh(self.vertices, self.faces, point, across)
        corners = self.vertices[self.faces]
        return [
            _Outline(c.edges(self.faces).reshape(-1, 2), c.fractions.ravel(), c.at(corners).reshape(-1, 3))
            for c in curves
        ]

    def horizontal(self, height: float) -> _Outline:
        spine = np.array([0.0, height, 0.5 * (self.joint("neck")[2] + self.joint("pelvis")[2])])
        return self.around("torso", spine, UP)

    def extreme_level(self, low: float, high: float, sign: int) -> _Outline:
        # 5 mm steps are finer than a tape is placed; slices below the crotch go around single legs and are left out.
        found = []
        for height in np.arange(self.level(low), self.level(high), 0.005):
            for outline in self.outlines(np.array([0, height, 0]), UP):
                x = outline.points[:, 0]
                if x.min() < -0.05 and x.max() > 0.05:
                    found.append((sign * tape_length(outline.points, UP), len(found), outline))
        if not found:
            raise ValueError(f"body {self.name!r}: no torso between {self.level(low):.3f} and {self.level(high):.3f} m")
        return max(found)[2]

    def fullest_front(self, low: float, high: float) -> float:
        y = self.vertices[:, 1]
        width = 0.5 * np.abs(self.joint("L_shoulder")[0] - self.joint("R_shoulder")[0])
        band = (y > self.level(low)) & (y < self.level(high)) & (np.abs(self.vertices[:, 0]) < width)
        if not band.any():
            return self.level(0.5 * (low + high))
        return float(y[band][np.argmax(self.vertices[band, 2])])

    def thinnest_neck(self) -> tuple[_Outline, np.ndarray]:
        start, end = self.joint("neck"), self.joint("head")
        along = (end - start) / np.linalg.norm(end - start)
        outlines = [self.around("neck", start + t * (end - start), along) for t in np.linspace(0, 1, 25)]
        return min(outlines, key=lambda outline: tape_length(outline.points, along)), along

    def surface_point(self, name: str, start: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the ray from `start`, inside a limb, along `direction` first meets the skin."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        # Möller and Trumbore 1997, for all triangles at once.
        across = np.cross(direction, c - a)
        scale = np.einsum("nd,nd->n", b - a, across)
        scale = np.where(np.abs(scale) < 1e-15, np.nan, scale)
        u = np.einsum("nd,nd->n", start - a, across) / scale
        turned = np.cross(start - a, b - a)
        v = turned @ direction / scale
        distance = np.einsum("nd,nd->n", c - a, turned) / scale
        with np.errstate(invalid="ignore"):
            hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (distance > 0)
        if not hit.any():
            raise ValueError(f"body {self.name!r}: no skin {direction} of the {name} landmark at {start.round(3)}")
        face = int(np.argmin(np.where(hit, distance, np.inf)))
        return self.faces[face], np.array([1 - u[face] - v[face], u[face], v[face]])

    def band(self, name: str, outline: _Outline, across: np.ndarray) -> np.ndarray:
        """Edges within reach of a loop, without those of the arms where the loop is around the trunk."""
        height = (self.vertices - outline.points.mean(axis=0)) @ across
        allowed = np.abs(height) < _REACH[name]
        if name in ("chest", "waist", "hip"):
            arms = [k for k, joint in enumerate(self.names) if joint[2:] in ("shoulder", "elbow", "wrist", "hand")]
            allowed &= self.weights[:, arms].sum(axis=1) < 0.5
        edges, _ = unique_edges(self.faces, len(self.vertices))
        edges = edges[allowed[edges].all(axis=1)]
        size = (len(self.vertices), len(self.vertices))
        _, label = connected_components(coo_array((np.ones(len(edges)), edges.T), shape=size), directed=False)
        return edges[np.isin(label[edges[:, 0]], label[outline.edges.ravel()])]

    def crotch(self) -> tuple[np.ndarray, np.ndarray]:
        middle = self.outlines(np.zeros(3), np.array([1.0, 0.0, 0.0]))
        trunk = max(middle, key=lambda outline: np.ptp(outline.points[:, 1]))
        lowest = int(np.argmin(trunk.points[:, 1]))
        a, b = trunk.edges[lowest]
        share = float(trunk.fraction[lowest])
        return np.array([a, b, a]), np.array([1 - share, share, 0.0])
