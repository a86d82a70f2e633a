"""Garments as others make them: layers of cloth over the embedded body, in any unit, pose and place."""

import numpy as np

from tryon_jax.body import load_body
from tryon_jax.types import Body
from tryon_jax.wear.arms import LoweredArms

BODY: Body = load_body("female")
FLOOR = float(np.asarray(BODY.v_template)[:, 1].min())


def over_the_skin(
    keep: np.ndarray, away: float = 0.02, arms: float = 0.0, body: Body = BODY
) -> tuple[np.ndarray, np.ndarray]:
    """The faces of the body whose corners are all kept, `away` metres above the skin: vertices, faces."""
    skin = LoweredArms(body, arms).vertices
    all_faces = np.asarray(body.faces)
    corners = skin[all_faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(skin)
    np.add.at(total, all_faces.ravel(), np.repeat(normal, 3, axis=0))
    points = skin + away * total / np.linalg.norm(total, axis=1, keepdims=True)
    faces = all_faces[keep[all_faces].all(axis=1)]
    used, index = np.unique(faces, return_inverse=True)
    return points[used], index.reshape(faces.shape)


def tshirt(away: float = 0.02, arms: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """From the neck to the hips, with sleeves to above the elbows."""
    x, y, _ = np.asarray(BODY.v_template).T
    high = np.abs(x) > 0.2
    keep = (np.abs(x) < 0.33) & np.where(high, y > 0.25, (y > -0.05) & (y < 0.47 + 0.3 * np.abs(x)))
    return over_the_skin(keep, away, arms)


def skirt(away: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """A tube round the hips, wider below: vertices, faces."""
    turn, height = np.meshgrid(np.linspace(0, 2 * np.pi, 49)[:-1], np.linspace(-0.45, 0.1, 20))
    wide = 0.05 * np.clip(-height, 0, 1)
    across, deep = (half + away + wide for half in (0.2, 0.14))
    points = np.stack([across * np.sin(turn), height, deep * np.cos(turn) - 0.02], axis=-1)
    row, column = np.meshgrid(np.arange(19), np.arange(48), indexing="ij")
    a, b = row * 48 + column, row * 48 + (column + 1) % 48
    faces = np.concatenate(
        [np.stack([a, b, b + 48], -1).reshape(-1, 3), np.stack([a, b + 48, a + 48], -1).reshape(-1, 3)]
    )
    return points.reshape(-1, 3), faces


def ball(centre: tuple[float, float, float], radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed accessory."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return np.asarray(sphere.vertices) + centre, np.asarray(sphere.faces)


def together(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Several pieces as one mesh."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [faces + start for (_, faces), start in zip(parts, starts, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)
