"""A garment mesh of your own, of any topology: here a short sleeveless tube, made on the spot and saved as an OBJ file.

python examples/own_garment.py
"""

import tempfile
from pathlib import Path

import numpy as np

import tryon_jax as tj
from tryon_jax.contact.push_out import push_out
from tryon_jax.contact.signed_distance import ClosedSurface
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
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tube.obj"
        write_mesh(path, [mesh_part("tube", *tube_dress())])
        model = tj.load_pretrained()
        garment = tj.prepare(model, mesh=path)
    shape = np.array(betas, np.float32)
    before = garment.unpad(tj.drape(model, garment, shape))
    body = ClosedSurface(np.asarray(tj.shape_body(model.body, shape)[0]), np.asarray(model.body.faces))
    pushed = push_out(before, garment.faces, body)
    print(
        f"{garment.num_vertices} vertices; {100 * pushed.inside_before:.1f} % of the cloth was inside the body, now 0"
    )
    return before, pushed.vertices


if __name__ == "__main__":
    main()
