"""Predictions without learning: nearest-body-vertex transfer, and the nearest training garments (kNN).

The kNN predicts a vertex's displacement from the mean drape as that of the training garments' vertices that are
closest to it in their mean drapes, interpolated to the same body shape. It reads training samples only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from experiments.shared.evaluate import Stack, body_vertices
from tryon_jax.garment.manifest import Manifest
from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.training.dataset import STATISTICS, is_good, load_arrays, mean_path, mesh_path
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.protocol import EXTENT
from tryon_jax.training.thin_plate import thin_plate
from tryon_jax.tryon import TryOnModel

NEIGHBOURS = 8
PROBED = 16
"""Times as many vertices are looked at first: those of garments that do not know a shape are passed over."""
DESIGN_SCALE = 0.1
"""Metres that a design parameter's half range counts for in the key with designs."""
REACH = 0.3
"""Distance between body shapes, in half axes of what the dataset covers, up to which one may stand for another."""
_SOFTENING = 2e-3
_WILD = 3.0


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
    template_vertices: Int[np.ndarray, "V 3"]
    """Vertices of the template triangle in which each vertex lies."""
    template_weights: Float[np.ndarray, "V 3"]


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
        mesh["template_vertices"],
        mesh["template_weights"],
    )


def transfer(model: TryOnModel, mean: Float[np.ndarray, "V 3"], betas: Float[np.ndarray, "S b"]) -> Stack:
    """M̄ moved with the closest vertex of the mean body."""
    nearest = cKDTree(np.asarray(model.body.v_template)).query(mean)[1]
    moved = body_vertices(model, betas)[:, nearest] - np.asarray(model.body.v_template)[None, nearest]
    return mean[None] + moved


def shape_weights(known: Float[np.ndarray, "K b"], wanted: Float[np.ndarray, "S b"]) -> Float[np.ndarray, "S K"]:
    """Weights of known body shapes that interpolate at the wanted ones; rows sum to 1.

    A thin plate over the betas; the closest shape alone where the known ones do not determine one (too few, or on a
    line).
    """
    distance = np.linalg.norm(wanted[:, None] - known[None], axis=-1)
    closest = np.eye(len(known))[distance.argmin(axis=1)]
    weights = thin_plate(known, np.eye(len(known)), wanted)
    if weights is None:
        return closest
    wild = np.abs(weights).sum(axis=1) > _WILD
    return np.where(wild[:, None], closest, weights)


def distance_weights(distance: Float[np.ndarray, "V k"]) -> Float[np.ndarray, "V k"]:
    """Weights of k neighbours by the inverse squares of their distances, rounded off at two millimetres; sum 1."""
    weights = 1.0 / (distance**2 + _SOFTENING**2)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


class NearestGarments:
    """The training garments' displacements at given body shapes, found by position in the mean drape."""

    def __init__(self, garments: Sequence[Drapes], manifest: Manifest, betas: Float[np.ndarray, "S b"]) -> None:
        """Keeps what the training shapes of `garments` (one fabric) say about the shapes `betas`.

        A garment says nothing about a shape that none of its good training shapes is near to.

        Raises:
            PermissionError: a garment's design or topology is for testing.
        """
        self.betas = betas
        self._center, self._half = manifest.space.mean, 0.5 * (manifest.space.maximum - manifest.space.minimum)
        extent = np.array(EXTENT[: betas.shape[1]])[None]
        keys, known, first = [], [], 0
        # Filled in place: with hundreds of garments these are gigabytes.
        self._moves = np.empty((len(betas), sum(len(drapes.mean) for drapes in garments), 3), np.float32)
        for drapes in garments:
            label, seed = drapes.name.rsplit("-", 1)
            if manifest.split(label, int(seed)) != "training":
                raise PermissionError(f"{drapes.name} is a test garment: nothing may be learned from it")
            rows = np.flatnonzero(drapes.good & ~drapes.test)
            if not len(rows):
                continue
            shapes, wanted = drapes.betas[rows] / extent, betas / extent
            weights = shape_weights(shapes.astype(np.float64), wanted.astype(np.float64)).astype(np.float32)
            displacement = drapes.vertices[rows] - drapes.mean[None]
            here = slice(first, first + len(drapes.mean))
            first = here.stop
            self._moves[:, here] = np.einsum("sk,kvc->svc", weights, displacement, optimize=True)
            near = np.linalg.norm(wanted[:, None] - shapes[None], axis=-1).min(axis=1) <= REACH
            known.append(np.broadcast_to(near[:, None], (len(betas), len(drapes.mean))))
            design = np.broadcast_to(self._scaled(drapes.design), (len(drapes.mean), len(self._half)))
            keys.append(np.concatenate([drapes.mean, design], axis=1))
        self._keys, self._moves = np.concatenate(keys), self._moves[:, :first]
        self._known = np.concatenate(known, axis=1)
        self._trees: dict[int, cKDTree] = {}

    def __call__(
        self, samples: SimulatedGarment, rows: np.ndarray, with_design: bool, neighbours: int = NEIGHBOURS
    ) -> Stack:
        """Drapes of a garment at the shapes of its samples `rows`, which must be among those asked for."""
        mean = samples.garment.mean_vertices
        design = np.broadcast_to(self._scaled(np.asarray(samples.garment.design)), (len(mean), len(self._half)))
        key = np.concatenate([mean, design], axis=1)[:, : self._width(with_design)]
        tree = self._tree(self._width(with_design))
        near = tree.query(key, k=np.arange(1, min(PROBED * neighbours, tree.n) + 1))
        found = []
        for beta in samples.betas[rows]:
            shape = int(np.abs(self.betas - beta[None]).sum(-1).argmin())
            distance, index = self._known_ones(tree, key, near, shape, neighbours)
            found.append(mean + np.einsum("vk,vkc->vc", distance_weights(distance), self._moves[shape][index]))
        return np.stack(found)

    def _known_ones(
        self, tree: cKDTree, key: np.ndarray, near: tuple[np.ndarray, np.ndarray], shape: int, neighbours: int
    ) -> tuple[Float[np.ndarray, "V k"], Int[np.ndarray, "V k"]]:
        """The closest vertices that are known at a shape: among those that are close, else among more of them."""
        known = self._known[shape]
        if not known.any():
            raise ValueError(f"no training garment knows a body near betas {self.betas[shape]}")
        wanted = min(neighbours, int(known.sum()))
        distance, index = np.zeros((len(key), wanted)), np.zeros((len(key), wanted), np.int64)
        rows, (far, at) = np.arange(len(key)), near
        while True:
            there = known[at]
            enough = there.sum(axis=1) >= wanted
            taken = there[enough] & (there[enough].cumsum(axis=1) <= wanted)
            distance[rows[enough]] = far[enough][taken].reshape(-1, wanted)
            index[rows[enough]] = at[enough][taken].reshape(-1, wanted)
            rows = rows[~enough]
            if not len(rows):
                return distance, index
            far, at = tree.query(key[rows], k=np.arange(1, min(4 * at.shape[1], tree.n) + 1))

    def _width(self, with_design: bool) -> int:
        return self._keys.shape[1] if with_design else 3

    def _tree(self, width: int) -> cKDTree:
        if width not in self._trees:
            self._trees[width] = cKDTree(self._keys[:, :width])
        return self._trees[width]

    def _scaled(self, design: np.ndarray) -> np.ndarray:
        return DESIGN_SCALE * (design - self._center) / self._half
