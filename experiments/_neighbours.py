"""Predictions without learning: nearest-body-vertex transfer, and the nearest training garments (kNN).

The kNN predicts a vertex's displacement from the mean drape as that of the training garments' vertices that are
closest to it in their mean drapes, interpolated to the same body shape. It reads training samples only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from experiments._evaluate import Stack, body_vertices
from tryon_jax.garment.manifest import Manifest
from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.training.dataset import STATISTICS, is_good, load_arrays, mean_path, mesh_path
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.tryon import TryOnModel

NEIGHBOURS = 8
DESIGN_SCALE = 0.1
"""Metres that a design parameter's half range counts for in the key with designs."""
_SOFTENING = 2e-3


@dataclass(frozen=True, eq=False)
class Drapes:
    """All simulated drapes of one garment in one fabric, without the graph that networks need."""

    name: str
    mean: Float[np.ndarray, "V 3"]
    """M̄, metres."""
    design: Float[np.ndarray, " P"]
    betas: Float[np.ndarray, "S b"]
    vertices: Stack
    good: Bool[np.ndarray, " S"]
    test: Bool[np.ndarray, " S"]


def load_drapes(model: TryOnModel, root: Path, name: str, fabric: str) -> Drapes:
    """Read a garment's drapes."""
    mesh = load_arrays(mesh_path(root, name))
    template = np.asarray(apply_mean_drape(model.mean, jnp.asarray(mesh["design"], jnp.float32)))
    origin = load_arrays(mean_path(root, name, fabric))
    rays = [load_arrays(path) for path in sorted((root / "rays").glob(f"{name}_{fabric}_*.npz"))]
    width = model.config.num_betas
    return Drapes(
        name,
        np.einsum("vk,vkc->vc", mesh["template_weights"], template[mesh["template_vertices"]]).astype(np.float32),
        mesh["design"],
        np.round(np.concatenate([np.zeros((1, width)), *(ray["betas"] for ray in rays)]), 6).astype(np.float32),
        np.concatenate([origin["vertices"][None], *(ray["vertices"] for ray in rays)]),
        np.concatenate(
            [[is_good({k: origin[k] for k in STATISTICS})], *(is_good({k: r[k] for k in STATISTICS}) for r in rays)]
        ),
        np.concatenate([[False], *(ray["test"] for ray in rays)]).astype(bool),
    )


def transfer(model: TryOnModel, mean: Float[np.ndarray, "V 3"], betas: Float[np.ndarray, "S b"]) -> Stack:
    """M̄ moved with the closest vertex of the mean body."""
    nearest = cKDTree(np.asarray(model.body.v_template)).query(mean)[1]
    moved = body_vertices(model, betas)[:, nearest] - np.asarray(model.body.v_template)[None, nearest]
    return mean[None] + moved


def shape_weights(known: Float[np.ndarray, "K b"], wanted: Float[np.ndarray, "S b"]) -> Float[np.ndarray, "S K"]:
    """Weights of known body shapes that interpolate (thin plate over the betas) at the wanted ones."""
    if len(known) <= known.shape[1] + 1:
        distance = np.linalg.norm(wanted[:, None] - known[None], axis=-1)
        return np.eye(len(known))[distance.argmin(axis=1)]
    return RBFInterpolator(known, np.eye(len(known)), kernel="thin_plate_spline", degree=1)(wanted)


class NearestGarments:
    """The training garments' displacements at given body shapes, found by position in the mean drape."""

    def __init__(self, garments: Sequence[Drapes], manifest: Manifest, betas: Float[np.ndarray, "S b"]) -> None:
        """Keeps what the training shapes of `garments` (one fabric) say about the shapes `betas`.

        Raises:
            PermissionError: a garment's design or topology is for testing.
        """
        self.betas = betas
        self._center, self._half = manifest.space.mean, 0.5 * (manifest.space.maximum - manifest.space.minimum)
        designs, moves = [], []
        for drapes in garments:
            label, seed = drapes.name.rsplit("-", 1)
            if manifest.split(label, int(seed)) != "training":
                raise PermissionError(f"{drapes.name} is a test garment: nothing may be learned from it")
            rows = np.flatnonzero(drapes.good & ~drapes.test)
            weights = shape_weights(drapes.betas[rows].astype(np.float64), betas.astype(np.float64))
            displacement = drapes.vertices[rows] - drapes.mean[None]
            moves.append(np.einsum("sk,kvc->svc", weights.astype(np.float32), displacement, optimize=True))
            designs.append(np.broadcast_to(self._scaled(drapes.design), (len(drapes.mean), len(self._half))))
        positions = np.concatenate([drapes.mean for drapes in garments])
        self._moves = np.concatenate(moves, axis=1)
        keys = np.concatenate([positions, np.concatenate(designs)], axis=1)
        self._trees = {False: cKDTree(positions), True: cKDTree(keys)}

    def __call__(
        self, samples: SimulatedGarment, rows: np.ndarray, with_design: bool, neighbours: int = NEIGHBOURS
    ) -> Stack:
        """Drapes of a garment at the shapes of its samples `rows`, which must be among those asked for."""
        mean = samples.garment.mean_vertices
        key = mean
        if with_design:
            design = self._scaled(np.asarray(samples.garment.design))
            key = np.concatenate([mean, np.broadcast_to(design, (len(mean), len(self._half)))], axis=1)
        distance, index = self._trees[with_design].query(key, k=neighbours)
        weights = 1.0 / (distance**2 + _SOFTENING**2)
        weights = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
        at = np.abs(samples.betas[rows][:, None] - self.betas[None]).sum(-1).argmin(axis=1)
        return mean[None] + np.stack([np.einsum("vk,vkc->vc", weights, self._moves[s][index]) for s in at])

    def _scaled(self, design: np.ndarray) -> np.ndarray:
        return DESIGN_SCALE * (design - self._center) / self._half
