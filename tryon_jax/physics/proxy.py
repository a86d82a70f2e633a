"""The body that cloth collides with: mittens instead of fingers, feet without toes.

Cloth at the resolution of a garment cannot rest on a thumb or a toe: they pass through cuffs and hems. Hands are cut
off at the wrist and replaced by a closed tube that encloses them, feet are smoothed. Everything else is the skin.
"""

import itertools
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.linalg import splu

from tryon_jax.mesh.topology import border_loops, unique_edges
from tryon_jax.types import Body

RINGS = ((0.25, 1.0), (0.6, 1.0), (0.9, 0.8), (1.02, 0.45))
"""Rings of a mitten: position from wrist to finger tips, and share of the hand's extent there."""
WRIST_MARGIN = 0.01
"""Metres beyond the wrist joint where the hand is cut."""
TOE_LENGTH = 0.02
"""Length in metres over which feet are smoothed."""
TOE_SCALE = 1.04
"""Smoothing shrinks: feet are scaled back by this about their centre."""


@dataclass(frozen=True, eq=False)
class Mitten:
    """A tube that replaces one hand."""

    loop: Int[np.ndarray, " L"]
    """Body vertices on the cut, in order."""
    hand: Int[np.ndarray, " H"]
    """Body vertices beyond the cut."""


@dataclass(frozen=True, eq=False)
class CollisionBody:
    """Fixed connectivity of the collision surface; `vertices` follows any shape of the body."""

    faces: Int[np.ndarray, "F 3"]
    keep: Int[np.ndarray, " N"]
    """Body vertices that the collision surface keeps."""
    mittens: tuple[Mitten, ...]
    feet: tuple[Int[np.ndarray, " K"], ...]
    """Body vertices of each foot."""
    foot_smoothers: tuple[sp.csr_matrix, ...]

    def vertices(self, body_vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
        """Collision vertices for a shape of the body, metres."""
        skin = np.array(body_vertices, float)
        for foot, smoother in zip(self.feet, self.foot_smoothers, strict=True):
            smooth = smoother @ skin[foot]
            centre = smooth.mean(axis=0)
            skin[foot] = centre + TOE_SCALE * (smooth - centre)
        return np.concatenate([skin[self.keep], *[_tube(skin, mitten) for mitten in self.mittens]])


def skinning_weights(collision: CollisionBody, weights: Float[np.ndarray, "V J"]) -> Float[np.ndarray, "W J"]:
    """Skinning weights of the collision vertices: those of the skin, and in each mitten the mean of its hand.

    Args:
        collision: Of the body.
        weights: Of the body's own vertices.
    """
    tubes = [
        np.broadcast_to(weights[m.hand].mean(axis=0), (len(RINGS) * len(m.loop) + 1, weights.shape[1]))
        for m in collision.mittens
    ]
    return np.concatenate([weights[collision.keep], *tubes])


def build_collision_body(body: Body) -> CollisionBody:
    """Collision surface of a body with SMPL's joints in T-pose; other bodies collide with their plain skin."""
    template, faces = np.asarray(body.v_template, float), np.asarray(body.faces)
    names = list(body.joint_names)
    count = len(template)
    if "L_wrist" not in names or "L_ankle" not in names:
        return CollisionBody(faces, np.arange(count), (), (), ())
    joints = np.asarray(body.J_regressor) @ template
    mittens, gone = [], np.zeros(count, bool)
    for side, sign in (("L", 1.0), ("R", -1.0)):
        cut = sign * joints[names.index(f"{side}_wrist"), 0] + WRIST_MARGIN
        hand = np.flatnonzero(sign * template[:, 0] > cut)
        gone[hand] = True
        # The open border left by the hand, among the vertices that stay.
        kept = faces[~np.isin(faces, hand).any(axis=1)]
        loop = max(border_loops(kept, count), key=len)
        mittens.append(Mitten(loop, hand))
    kept = faces[~gone[faces].any(axis=1)]
    keep = np.flatnonzero(np.bincount(kept.ravel(), minlength=count))
    index = np.full(count, -1)
    index[keep] = np.arange(len(keep))
    all_faces, offset = [index[kept]], len(keep)
    for mitten in mittens:
        all_faces.append(_tube_faces(index[mitten.loop], offset))
        offset += len(RINGS) * len(mitten.loop) + 1
    feet = [
        np.flatnonzero(_below(template, joints[names.index(f"{s}_ankle")], sign)) for s, sign in (("L", 1), ("R", -1))
    ]
    smoothers = tuple(_smoother(template, faces, foot) for foot in feet)
    return CollisionBody(np.concatenate(all_faces), keep, tuple(mittens), tuple(feet), smoothers)


def _below(template: np.ndarray, ankle: np.ndarray, sign: int) -> np.ndarray:
    return (template[:, 1] < ankle[1]) & (sign * template[:, 0] > 0)


def _tube(skin: np.ndarray, mitten: Mitten) -> np.ndarray:
    """Rings of the mitten from the wrist outwards, then its tip; each as wide as the hand, axis along x."""
    loop, hand = skin[mitten.loop], skin[mitten.hand]
    centre, wrist = loop.mean(axis=0), np.abs(loop[:, 1:] - loop.mean(axis=0)[1:]).max(axis=0)
    low, high = hand.min(axis=0), hand.max(axis=0)
    tip_x = high[0] if centre[0] > 0 else low[0]
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    rings = []
    for position, share in RINGS:
        blend = min(1.0, position / RINGS[0][0])
        scale = np.maximum(1.0, half[1:] / wrist) * share
        ring = np.empty_like(loop)
        ring[:, 0] = centre[0] + position * (tip_x - centre[0])
        origin = (1 - blend) * centre[1:] + blend * middle[1:]
        ring[:, 1:] = origin + (loop[:, 1:] - centre[1:]) * scale
        rings.append(ring)
    tip = np.array([[centre[0] + 1.06 * (tip_x - centre[0]), *middle[1:]]])
    return np.concatenate([*rings, tip])


def _tube_faces(loop: np.ndarray, offset: int) -> np.ndarray:
    """Quads between consecutive rings and a fan at the tip, wound like the faces beside the cut."""
    size = len(loop)
    rings = [loop, *[offset + k * size + np.arange(size) for k in range(len(RINGS))]]
    tip = offset + len(RINGS) * size
    faces = []
    for inner, outer in itertools.pairwise(rings):
        a, b = inner, np.roll(inner, -1)
        c, d = outer, np.roll(outer, -1)
        # The loop runs along its faces, so the new faces run against it.
        faces += [np.stack([b, a, c], axis=1), np.stack([b, c, d], axis=1)]
    last = rings[-1]
    faces.append(np.stack([np.roll(last, -1), last, np.full(size, tip)], axis=1))
    return np.concatenate(faces)


def _smoother(template: np.ndarray, faces: np.ndarray, foot: np.ndarray) -> sp.csr_matrix:
    """(I + length² L)⁻¹ on a foot with umbrella weights over squared edge lengths; its upper border stays."""
    count = len(template)
    index = np.full(count, -1)
    index[foot] = np.arange(len(foot))
    edges, _ = unique_edges(faces, count)
    inside = edges[(index[edges] >= 0).all(axis=1)]
    fixed = np.unique(edges[(index[edges] >= 0).any(axis=1) & ~(index[edges] >= 0).all(axis=1)])
    a, b = index[inside].T
    weights = TOE_LENGTH**2 / ((template[inside[:, 0]] - template[inside[:, 1]]) ** 2).sum(axis=1)
    adjacency = sp.coo_matrix((np.r_[weights, weights], (np.r_[a, b], np.r_[b, a])), (len(foot),) * 2).tocsr()
    laplacian = sp.diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency
    free = np.ones(len(foot))
    free[index[fixed[index[fixed] >= 0]]] = 0
    system = sp.eye(len(foot)) + sp.diags(free) @ laplacian / 6
    return sp.csr_matrix(np.asarray(splu(system.tocsc()).solve(np.eye(len(foot)))))
