"""A garment that is not of the pattern: a belt that sits on the hips of the mean body."""

import numpy as np


def snug_belt() -> tuple[np.ndarray, np.ndarray]:
    """Vertices, metres, and triangles."""
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    height = np.linspace(-0.12, 0.18, 13)
    around, level = np.meshgrid(angle, height)
    vertices = np.stack([0.17 * np.sin(around), level, 0.125 * np.cos(around)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(12), np.arange(48), indexing="ij")
    a, b = i * 48 + j, i * 48 + (j + 1) % 48
    pairs = [np.stack([a, b, a + 48], -1), np.stack([b, b + 48, a + 48], -1)]
    return vertices, np.concatenate([pair.reshape(-1, 3) for pair in pairs])
