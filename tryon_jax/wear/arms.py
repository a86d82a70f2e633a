"""A body with its arms lowered, and garments made on such a body brought back to the T-pose.

Only the shoulders turn, so skinning has a closed form: with weights a in [0, 1] for the arm below a shoulder c, a point
goes to (1 - a) x + a (c + R (x - c)), which a 3 x 3 system takes back.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tryon_jax.graph.skinning import soft_skinning
from tryon_jax.types import Body

_SIDES = (("L_shoulder", -1.0), ("R_shoulder", 1.0))


@dataclass(frozen=True, eq=False)
class LoweredArms:
    """The mean shape of `body` in T-pose with both arms turned down by `degrees` about the front axis."""

    body: Body
    degrees: float

    @cached_property
    def weights(self) -> Float[np.ndarray, "V 2"]:
        """Share of the left and the right arm in each vertex."""
        skinning = np.asarray(self.body.lbs_weights, np.float64)
        arms = []
        for name, _ in _SIDES:
            member = {self.body.joint_names.index(name)}
            for joint, parent in enumerate(self.body.parents):
                if parent in member:
                    member.add(joint)
            arms.append(skinning[:, sorted(member)].sum(axis=1))
        return np.stack(arms, axis=1)

    @cached_property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Metres."""
        points = np.asarray(self.body.v_template, np.float64)
        linear, shift = self._motion(self.weights)
        return np.einsum("vab,vb->va", linear, points) + shift

    def _motion(self, weights: Float[np.ndarray, "N 2"]) -> tuple[Float[np.ndarray, "N 3 3"], Float[np.ndarray, "N 3"]]:
        """Skinning of points with these shares of the arms."""
        points = np.asarray(self.body.v_template, np.float64)
        joints = np.asarray(self.body.J_regressor, np.float64) @ points
        linear, shift = np.tile(np.eye(3), (len(weights), 1, 1)), np.zeros((len(weights), 3))
        for (name, side), share in zip(_SIDES, weights.T, strict=True):
            angle = side * np.deg2rad(self.degrees)
            cosine, sine = np.cos(angle), np.sin(angle)
            turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]) - np.eye(3)
            centre = joints[self.body.joint_names.index(name)]
            linear += share[:, None, None] * turn
            shift -= share[:, None] * (turn @ centre)
        return linear, shift

    def raise_garment(
        self, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], rounds: int = 10
    ) -> Float[np.ndarray, "V 3"]:
        """A garment on the body with lowered arms, moved to the T-pose, metres.

        Args:
            vertices: the garment, metres.
            faces: its triangles.
            rounds: smoothing of its skinning weights over neighbours.
        """
        if self.degrees == 0:
            return np.asarray(vertices, np.float64)
        nearest = cKDTree(self.vertices).query(vertices)[1]
        share = self.weights[nearest]
        rest = np.maximum(1 - share.sum(axis=1, keepdims=True), 0)
        share = soft_skinning(np.concatenate([share, rest], axis=1), faces, rounds)[:, :2]
        linear, shift = self._motion(share)
        return np.linalg.solve(linear, (vertices - shift)[..., None])[..., 0]
