"""A drape transferred from the networks' body to another one, such as an SMPL file: an approximation, not a learned
result.

The networks know one body. Another body in T-pose gets the drape of that body's nearest shape (by stature and girths),
moved along by the joints that both have, bone by bone. What then lies inside is for the push-out to mend.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tryon_jax.body import betas_from_measurements, shape_body
from tryon_jax.body.landmarks import Landmarks, load_landmarks
from tryon_jax.body.measurements import measure_vertices
from tryon_jax.body.smpl import SMPL_JOINTS
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.types import ArrayLike, Body

ALIKE = ("stature", "chest", "waist", "hip")
"""Measurements by which the nearest shape is found."""

_measure = jax.jit(measure_vertices)
_shape = jax.jit(shape_body)


@dataclass(frozen=True, eq=False)
class OtherBody:
    """Another body with its relation to the networks' one; made by `prepare_other_body`."""

    body: Body
    landmarks: Landmarks
    known: Body
    """The networks' body, with the betas that they see."""
    known_landmarks: Landmarks

    def nearest_betas(self, vertices: Float[ArrayLike, "V 3"]) -> Float[np.ndarray, " b"]:
        """Betas of the networks' body whose stature and girths are nearest to those of `vertices` (this body's)."""
        measured = _measure(vertices, self.landmarks)
        asked = {name: float(measured[name]) for name in ALIKE}
        return np.asarray(betas_from_measurements(self.known, asked, self.known_landmarks).betas)

    def transfer(
        self,
        garment: Float[np.ndarray, "V 3"],
        weights: Float[np.ndarray, "V J"],
        known_betas: Float[ArrayLike, " b"],
        betas: Float[ArrayLike, " c"],
    ) -> Float[np.ndarray, "V 3"]:
        """The garment moved from the networks' body of shape `known_betas` to this body of shape `betas`, metres.

        Args:
            garment: the drape, metres.
            weights: its skinning weights on the networks' body, e.g. from `tryon_jax.graph.skinning.garment_skinning`.
            known_betas: shape of the networks' body that it was draped on.
            betas: shape of this body.
        """
        here, there = (
            np.asarray(_shape(body, jnp.asarray(b, jnp.float32))[1], np.float64)[_rows(body)]
            for body, b in ((self.known, known_betas), (self.body, betas))
        )
        linear = _bones(self.known, here, there)
        moved = np.zeros_like(garment, np.float64)
        for joint, weight in enumerate((weights @ _folded(self.known)).T):
            moved += weight[:, None] * (there[joint] + (garment - here[joint]) @ linear[joint].T)
        return moved.astype(np.float32)


def prepare_other_body(body: Body, known: Body, num_betas: int) -> OtherBody:
    """Prepare the transfer of drapes from the networks' body to another body.

    Args:
        body: The body to be dressed.
        known: The networks' body.
        num_betas: Betas of `known` that the networks see.

    Raises:
        ValueError: the body's mesh is not closed, or it lacks a joint of `SMPL_JOINTS` or a landmark.
    """
    missing = [name for name in SMPL_JOINTS if name not in body.joint_names]
    if missing:
        raise ValueError(f"body {body.name!r} lacks the joints {', '.join(missing)}, which carry the garment")
    try:
        ClosedSurface(np.asarray(body.v_template), np.asarray(body.faces))
    except ValueError as error:
        raise ValueError(f"body {body.name!r} cannot be dressed: {error}") from error
    few = replace(known, shapedirs=known.shapedirs[..., :num_betas])
    return OtherBody(body, load_landmarks(body), few, load_landmarks(known))


def _rows(body: Body) -> list[int]:
    return [body.joint_names.index(name) for name in SMPL_JOINTS]


def _parents(body: Body) -> list[int]:
    """Parent of each shared joint, as an index into `SMPL_JOINTS`; -1 for the root."""
    rows = _rows(body)
    return [rows.index(body.parents[row]) if body.parents[row] in rows else -1 for row in rows]


def _folded(body: Body) -> Float[np.ndarray, "J S"]:
    """Takes weights of all joints to those of the shared ones: hands go with their wrists."""
    rows = _rows(body)
    folded = np.zeros((len(body.parents), len(rows)))
    for joint in range(len(body.parents)):
        ancestor = joint
        while ancestor not in rows:
            ancestor = body.parents[ancestor]
        folded[joint, rows.index(ancestor)] = 1.0
    return folded


def _bones(body: Body, here: np.ndarray, there: np.ndarray) -> Float[np.ndarray, "S 3 3"]:
    """What turns and stretches each bone of one skeleton into that of the other; joints that fork stay as they are."""
    parents = np.array(_parents(body))
    linear = np.tile(np.eye(3), (len(parents), 1, 1))
    for joint in range(len(parents)):
        children = np.flatnonzero(parents == joint)
        if len(children) != 1:
            continue
        old, new = here[children[0]] - here[joint], there[children[0]] - there[joint]
        a, b = old / np.linalg.norm(old), new / np.linalg.norm(new)
        stretch = np.eye(3) + (np.linalg.norm(new) / np.linalg.norm(old) - 1) * np.outer(a, a)
        # The least rotation from a to b (Rodrigues), for bones that are never opposite in two T-poses.
        cross = np.cross(a, b)
        skew = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
        linear[joint] = (np.eye(3) + skew + skew @ skew / (1 + a @ b)) @ stretch
    return linear
