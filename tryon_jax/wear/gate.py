"""The check of every drape before it is shown or written: fine, a warning that names the place, or refused.

Host side. The measures and their limits are in one table, `LIMITS`. They come from the physics and from data: knitted
cloth bears about a quarter more area before it is hard to put on; edges of simulated drapes reach 1.4 times their rest
length; in learned drapes of random designs on bodies that the networks know, the 95th percentile of area reaches 1.28
and the push out of the body moves cloth by a few millimetres.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tryon_jax.contact.push_out import PushedOut
from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.mesh.quality import edge_lengths
from tryon_jax.mesh.stretch_limit import rest_lengths
from tryon_jax.metrics.strain import area_strain
from tryon_jax.types import Body

Outcome = Literal["fine", "warning", "refused"]


@dataclass(frozen=True)
class Limit:
    """From where a measure warns, and from where it refuses."""

    warn: float
    refuse: float
    why: str
    """What is wrong beyond it, for people."""
    advice: tuple[str, ...]
    """What to try next."""


_ANOTHER = "another seed or design, or --simulate, which asks no network"
_PLACE = "for a mesh of your own its unit, offset and pose"
_LARGER = "a larger size"
LIMITS: dict[str, Limit] = {
    "edge": Limit(1.4, 1.5, "an edge is {:.2f} times its rest length", (_ANOTHER, _LARGER, _PLACE)),
    "area": Limit(1.3, 1.6, "a twentieth of the cloth has {:.2f} times its area or more", (_LARGER,)),
    "inside": Limit(0.2, 0.5, "a share of {:.2f} of the cloth was inside the body, the deepest beyond 2 cm", (_PLACE,)),
    "push": Limit(0.03, 0.08, "the push out of the body moved the cloth by {:.3f} m", (_PLACE, _LARGER)),
    "left inside": Limit(0.0, 0.003, "cloth is still {:.4f} m inside the body", (_LARGER, _ANOTHER)),
    "far": Limit(0.35, 0.6, "cloth is {:.2f} m away from the body", (_PLACE, _ANOTHER)),
    "crossing": Limit(0.03, 0.3, "a share of {:.2f} of the triangles passes through others", (_ANOTHER,)),
    "betas": Limit(
        1.0, 1.5, "the body is {:.2f} times as far from the mean as the farthest learned", ("betas nearer 0",)
    ),
}
"""The measures: `edge`, largest length over rest length (the longer of pattern and mean drape); `area`, 95th percentile
of area over rest area; `inside`, share of the cloth inside the body before the push out, where the deepest is beyond
2 cm; `push`, largest move by it, metres; `left inside`, depth after it, metres; `far`, farthest from the skin, metres;
`crossing`, share of triangles that cross others; `betas`, the largest beta over the range that the weights know."""

DEEP = 0.02
"""Metres: cloth that is less deep, however much of it, is left to the push out."""
_MOST_FACES_CROSSED = 60_000


@dataclass(frozen=True)
class Finding:
    """One measure beyond its limit."""

    measure: str
    value: float
    outcome: Outcome
    place: str = ""
    """Where, in words, with the number of vertices; empty for the whole."""

    @property
    def text(self) -> str:
        """One sentence."""
        limit = LIMITS[self.measure]
        where = f" ({self.place})" if self.place else ""
        most = limit.refuse if self.outcome == "refused" else limit.warn
        return f"{limit.why.format(self.value)}{where}; at most {most:g}"


@dataclass(frozen=True)
class Verdict:
    """What the gate says of one drape."""

    findings: tuple[Finding, ...] = ()

    @property
    def outcome(self) -> Outcome:
        """The worst of the findings."""
        kinds = {finding.outcome for finding in self.findings}
        return "refused" if "refused" in kinds else "warning" if kinds else "fine"

    def lines(self) -> list[str]:
        """Report lines, one per finding."""
        words = {"warning": "warning ", "refused": "refused "}
        return [f"{words[finding.outcome]} {finding.text}" for finding in self.findings]

    def as_dict(self) -> dict[str, object]:
        """Outcome and findings in words, for JSON."""
        return {"outcome": self.outcome, "findings": [finding.text for finding in self.findings]}

    def check(self, name: str = "the drape") -> None:
        """Raise `Refused` for a drape that must not be written."""
        bad = [finding for finding in self.findings if finding.outcome == "refused"]
        if bad:
            advice = dict.fromkeys(one for f in bad for one in LIMITS[f.measure].advice)
            raise Refused(f"{name} is refused: {'; '.join(f.text for f in bad)}. What to try: {'; '.join(advice)}")


class Refused(ValueError):
    """The drape is invalid; nothing of it is written."""


def judge(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "U 2"],
    faces_uv: Int[np.ndarray, "F 3"],
    body: Body,
    body_vertices: Float[np.ndarray, "B 3"],
    *,
    mean: Float[np.ndarray, "V 3"] | None = None,
    pushed: PushedOut | None = None,
    clearance: Float[np.ndarray, " V"] | None = None,
) -> Verdict:
    """What is to be said of a finished drape.

    Args:
        vertices: the drape, metres.
        faces: its triangles.
        uv: its pattern, metres.
        faces_uv: entry of `uv` of every face corner.
        body: the body under it, for the names of places.
        body_vertices: that body's vertices, metres.
        mean: the garment on the mean body, metres: edges that are long there are not stretched by the drape.
        pushed: what the push out of the body did, where there was one.
        clearance: distance of each vertex from the body, metres, negative inside; without it `far` is not measured.
    """
    places = _Places(body, body_vertices)
    if not np.isfinite(vertices).all():
        wrong = ~np.isfinite(vertices).all(axis=1)
        return Verdict((Finding("far", float("inf"), "refused", f"{int(wrong.sum())} vertices are no numbers"),))
    found = [
        _edges(vertices, faces, uv, faces_uv, mean, places),
        _found("area", float(np.quantile(area_strain(vertices, faces, uv, faces_uv) + 1.0, 0.95))),
    ]
    if pushed is not None:
        if pushed.deepest_before > DEEP:
            found.append(_found("inside", pushed.inside_before))
        found += [_found("push", pushed.largest_move), _found("left inside", pushed.deepest)]
    if clearance is not None:
        far = clearance > LIMITS["far"].warn
        found.append(_found("far", float(clearance.max()), places.name(vertices[far])))
    if len(faces) <= _MOST_FACES_CROSSED:
        crossed = self_intersecting_faces(vertices, faces)
        found.append(_found("crossing", float(crossed.mean()), places.name(vertices[np.unique(faces[crossed])])))
    return Verdict(tuple(finding for finding in found if finding is not None))


def judge_betas(betas: Float[np.ndarray, " b"], known: Sequence[float]) -> Verdict:
    """What is to be said of a body whose betas go beyond `known`, the range of each that the weights were trained on.

    Betas within the range pass, beyond it they are warned of, far beyond refused; see `LIMITS`.
    """
    if not len(betas) or not len(known):
        return Verdict()
    extent = np.array([*known, *[known[-1]] * len(betas)], float)[: len(betas)]
    share = np.abs(np.asarray(betas, float)) / extent
    k = int(np.argmax(share))
    place = f"beta {k + 1} = {float(betas[k]):g}, known from {-extent[k]:g} to {extent[k]:g}"
    finding = _found("betas", float(share[k]), place)
    return Verdict(() if finding is None else (finding,))


def _found(measure: str, value: float, place: str = "") -> Finding | None:
    limit = LIMITS[measure]
    if value <= limit.warn:
        return None
    return Finding(measure, value, "refused" if value > limit.refuse else "warning", place)


def _edges(
    vertices: np.ndarray,
    faces: np.ndarray,
    uv: np.ndarray,
    faces_uv: np.ndarray,
    mean: np.ndarray | None,
    places: "_Places",
) -> Finding | None:
    rest = edge_lengths(uv, faces_uv) if mean is None else rest_lengths(faces, uv, faces_uv, mean)
    ratio = edge_lengths(vertices, faces) / rest
    long: Bool[np.ndarray, "F 3"] = ratio > LIMITS["edge"].warn
    ends = np.unique(np.concatenate([faces[long], np.roll(faces, -1, axis=1)[long]]))
    return _found("edge", float(ratio.max()), places.name(vertices[ends]))


_WORDS = {
    "pelvis": "hip", "spine1": "waist", "spine2": "waist", "spine3": "chest", "neck": "collar", "head": "collar",
    "hip": "thigh", "knee": "leg", "ankle": "leg", "foot": "leg", "collar": "shoulder", "shoulder": "shoulder",
    "elbow": "sleeve", "wrist": "sleeve", "hand": "sleeve",
}  # fmt: skip


class _Places:
    """Names for places on a body, by the joint that moves the skin there most."""

    def __init__(self, body: Body, vertices: np.ndarray) -> None:
        self._body, self._vertices = body, vertices

    def name(self, points: Float[np.ndarray, "N 3"]) -> str:
        """The most frequent places of some vertices, such as "collar, 12 vertices"."""
        if not len(points):
            return ""
        nearest = cKDTree(self._vertices).query(points)[1]
        joints = np.argmax(np.asarray(self._body.lbs_weights)[nearest], axis=1)
        common = Counter(_place_word(self._body.joint_names[joint]) for joint in joints).most_common(2)
        count = f"{len(points)} {'vertex' if len(points) == 1 else 'vertices'}"
        return f"{' and '.join(name for name, _ in common)}, {count}"


def _place_word(joint: str) -> str:
    side, _, name = joint.rpartition("_")
    word = _WORDS.get(name, "body")
    sides = {"L": "left ", "R": "right "}
    return sides.get(side, "") + word
