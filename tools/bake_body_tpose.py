"""Bring a MakeHuman body into SMPL's T-pose: arms along x, palms down, legs nearly parallel, feet flat."""

import numpy as np
from scipy.spatial.transform import Rotation

from tools.bake_body_makehuman import Rig

CLAVICLE_LIFT = np.radians(12)
"""Raising the arms takes the collar bones along."""
LEG_SPLAY = np.radians(4)
"""Angle of the line from hip to ankle from the vertical (5.7 degrees in MakeHuman's own pose)."""
FOREARM_ROLL = {"lowerarm01": 0.33, "lowerarm02": 0.75, "wrist": 1.0}
"""Part of the roll that turns the palm down at each bone, so that the skin of the forearm does not wring."""


def _frame(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rotation matrix with columns along `first`, `second` made orthogonal to it, and their cross product."""
    first = first / np.linalg.norm(first)
    second = second - (second @ first) * first
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], axis=1)


def _about(axis: int, angle: float) -> np.ndarray:
    return Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()


def _between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest rotation that turns unit vector `start` into unit vector `end`."""
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    return Rotation.from_rotvec(axis / max(sine, 1e-9) * np.arctan2(sine, start @ end)).as_matrix()


def _arm(at: dict[str, np.ndarray], side: float) -> dict[str, np.ndarray]:
    """World rotations of the bones of one arm; `at` holds the bone heads, `side` is +1 for the left."""
    x, front = np.array([side, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    shoulder, elbow, wrist = at["upperarm01"], at["lowerarm01"], at["wrist"]
    upper = _frame(x, front) @ _frame(elbow - shoulder, wrist - elbow).T
    forearm = upper @ (wrist - elbow)
    lower = _about(1, side * np.arctan2(forearm[2], side * forearm[0])) @ upper
    knuckles = lower @ (at["finger2-1"] - at["finger5-1"])
    roll = np.arctan2(knuckles[1], knuckles[2])
    rolled = {bone: _about(0, part * roll) @ lower for bone, part in FOREARM_ROLL.items()}
    hand = rolled["wrist"] @ (at["finger3-1"] - wrist)
    rolled["wrist"] = _between(hand / np.linalg.norm(hand), x) @ rolled["wrist"]
    lift = _about(2, side * CLAVICLE_LIFT)
    return {"clavicle": lift, "shoulder01": lift, "upperarm01": upper, "upperarm02": upper, **rolled}


def _leg(at: dict[str, np.ndarray], side: float) -> dict[str, np.ndarray]:
    """World rotations of the bones of one leg; the foot stays flat."""
    down = at["foot"] - at["upperleg01"]
    turn = _about(2, -side * (np.arctan2(side * down[0], -down[1]) - LEG_SPLAY))
    return {"foot": np.eye(3)} | dict.fromkeys(("upperleg01", "upperleg02", "lowerleg01", "lowerleg02"), turn)


def pose_bones(rig: Rig, heads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World rotations [B, 3, 3] and new heads [B, 3] of every bone in T-pose, from the heads [B, 3] at rest."""
    fixed: dict[str, np.ndarray] = {}
    for suffix, side in ((".L", 1.0), (".R", -1.0)):
        at = {bone.removesuffix(suffix): heads[k] for k, bone in enumerate(rig.names) if bone.endswith(suffix)}
        fixed |= {bone + suffix: turn for bone, turn in (_arm(at, side) | _leg(at, side)).items()}
    rotations, posed = np.tile(np.eye(3), (len(rig.names), 1, 1)), heads.copy()
    for bone, (name, parent) in enumerate(zip(rig.names, rig.parents, strict=True)):
        if parent >= 0:
            rotations[bone] = rotations[parent]
            posed[bone] = posed[parent] + rotations[parent] @ (heads[bone] - heads[parent])
        rotations[bone] = fixed.get(name, rotations[bone])
    return rotations, posed


def _multiply(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Product of quaternions (x, y, z, w)."""
    vector = p[:, 3:] * q[:, :3] + q[:, 3:] * p[:, :3] + np.cross(p[:, :3], q[:, :3])
    return np.concatenate([vector, p[:, 3:] * q[:, 3:] - (p[:, :3] * q[:, :3]).sum(1, keepdims=True)], axis=1)


def skin(
    vertices: np.ndarray, weights: np.ndarray, rotations: np.ndarray, heads: np.ndarray, posed: np.ndarray
) -> np.ndarray:
    """Dual quaternion skinning (Kavan et al. 2007), which keeps the volume of the lifted shoulders."""
    real = Rotation.from_matrix(rotations).as_quat()
    real *= np.where(real[:, 3:] < 0, -1, 1)
    shift = posed - np.einsum("bij,bj->bi", rotations, heads)
    dual = 0.5 * _multiply(np.concatenate([shift, np.zeros((len(shift), 1))], axis=1), real)
    real, dual = weights @ real, weights @ dual
    length = np.linalg.norm(real, axis=1, keepdims=True)
    real, dual = real / length, dual / length
    return Rotation.from_quat(real).apply(vertices) + 2 * _multiply(dual, real * np.array([-1, -1, -1, 1]))[:, :3]
