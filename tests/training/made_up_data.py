"""A data set as the simulator writes it, with made-up drapes on coarse garments."""

from pathlib import Path

import numpy as np

from tests.experiments.tiny_garments import AREA, FABRIC
from tryon_jax.garment import load_manifest, placement, remesh
from tryon_jax.training.dataset import (
    STATISTICS,
    DatasetConfig,
    mean_path,
    mesh_path,
    open_dataset,
    ray_path,
    save_arrays,
    template_path,
)
from tryon_jax.training.protocol import make_protocol

MANIFEST = load_manifest()
NAMES = ("tshirt-0", "additional-3-0", "additional-7-0", "tshirt-100")
RAYS = (0, 1, 2)


def statistics(count: int | None, **changes) -> dict[str, np.ndarray]:
    shape = () if count is None else (count,)
    return {key: np.full(shape, changes.get(key, 0.0), np.float32) for key in STATISTICS} | {"versions": np.array("{}")}


def draped(mesh, betas: np.ndarray, seed: int) -> np.ndarray:
    """Drapes that bend more and more with the betas, with folds that come and go."""
    rng = np.random.default_rng(seed)
    at = placement(mesh)
    waves = [np.sin(at @ rng.normal(size=3) * k) for k in (8, 20, 40)]
    ways = rng.normal(size=(3, 3))
    amounts = np.stack([0.02 * betas[:, 0], 0.01 * betas[:, 1], 0.004 * np.sin(3 * betas[:, 0] * betas[:, 1])], axis=1)
    moved = np.einsum("sk,kv,kc->svc", amounts, np.stack(waves), ways)
    return (at[None] + moved + 2e-4 * rng.normal(size=moved.shape)).astype(np.float32)


def make_full(root: Path) -> Path:
    """Four garments, one of them for testing, on three rays each."""
    open_dataset(root, DatasetConfig(fabrics=(FABRIC,), target_area=AREA))
    protocol = make_protocol(2)
    for number, name in enumerate(NAMES):
        label, seed = name.rsplit("-", 1)
        design = MANIFEST.design(label)
        mesh = remesh(MANIFEST.space, design, AREA, seed=int(seed))
        arrays = {"faces": mesh.faces.astype(np.int32), "faces_uv": mesh.faces_uv.astype(np.int32)}
        arrays |= {"uv": mesh.uv, "start": placement(mesh)}
        arrays |= {"template_vertices": mesh.template_vertices.astype(np.int32)}
        arrays |= {"template_weights": mesh.template_weights, "design": np.asarray(design.values, float)}
        save_arrays(mesh_path(root, name), arrays)
        mean = draped(mesh, np.zeros((1, 2)), number)[0]
        save_arrays(mean_path(root, name, FABRIC), {"vertices": mean, **statistics(None)})
        for ray in RAYS:
            betas = protocol.rays[ray]
            table = statistics(len(betas)) | {"betas": betas, "test": protocol.test[ray]}
            table["vertices"] = draped(mesh, betas, number)
            if ray == 2:
                # One shape that is thrown out, and one whose simulation ran away.
                table["depth"] = np.float32([0.0, 0.0, 0.01, *[0.0] * (len(betas) - 3)])
                table["residual"] = np.float32([0.0, 0.0, 0.0, np.nan, *[0.0] * (len(betas) - 4)])
                table["vertices"][3] = np.nan
            save_arrays(ray_path(root, name, FABRIC, ray), table)
        template = {"design": arrays["design"], "template": np.full((403, 3), 0.1 * number), **statistics(None)}
        save_arrays(template_path(root, label), template)
    return root
