"""A garment mesh of your own, of any topology: here a short sleeveless tube, made on the spot and saved as an OBJ file.

python examples/own_garment.py
"""

import tempfile
from pathlib import Path

import numpy as np

import tryon_jax as tj
from tryon_jax.files.export import mesh_part, write_mesh


def tube_dress(rows: int = 34, columns: int = 72) -> tuple[np.ndarray, np.ndarray]:
    """An elliptic tube from the armpits to the knees, flaring out towards the hem; metres, as on the mean body."""
    height = np.linspace(0.36, -0.40, rows)
    angle = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    flare = 1 + 0.55 * (height.max() - height) / np.ptp(height)
    around, level = np.meshgrid(angle, np.arange(rows))
    x = 0.17 * flare[level] * np.sin(around)
    z = 0.145 * flare[level] * np.cos(around) + 0.01
    vertices = np.stack([x, height[level], z], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    faces = np.concatenate([np.stack([a, c, b], axis=-1).reshape(-1, 3), np.stack([b, c, d], axis=-1).reshape(-1, 3)])
    return vertices, faces


def main(betas: tuple[float, ...] = (1.0, -1.0)) -> tuple[np.ndarray, np.ndarray]:
    """Drape the tube on a body and push it out; returns its vertices before and after."""
    session = tj.Session()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tube.obj"
        write_mesh(path, [mesh_part("tube", *tube_dress())])
        garment = session.prepare(mesh=path)
    dressed = session.try_on(garment, betas)
    print("\n".join(dressed.fit.lines()))
    print(f"{100 * dressed.pushed.inside_before:.1f} % of the cloth was inside the body before the push")
    return dressed.fine, dressed.vertices


if __name__ == "__main__":
    main()
