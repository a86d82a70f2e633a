"""Training samples in memory: prepared garments with their simulated drapes, split enforced when they are read."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from tryon_jax.garment.manifest import Manifest
from tryon_jax.graph.build import build_graph
from tryon_jax.graph.smoothing import HeatSmoother, make_smoother, smooth
from tryon_jax.mesh.quality import edge_lengths
from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.training.drapes import load_drapes, load_mesh
from tryon_jax.tryon import Garment, TryOnModel, padded_edges

TRAINING_BUCKETS = (2048, 2816, 3584)
"""Sizes that training garments are padded to; fewer than `prepare` has, since each costs a compilation."""


def training_bucket(num_vertices: int) -> int | None:
    """Size that a training garment is padded to; None for one larger than all, which gets a size of its own."""
    return next((bucket for bucket in TRAINING_BUCKETS if bucket >= num_vertices), None)


@dataclass(frozen=True, eq=False)
class SimulatedGarment:
    """One garment mesh with all its kept drapes, padded to the graph's bucket."""

    name: str
    garment: Garment
    betas: Float[np.ndarray, "S b"]
    """Body shape of each sample."""
    test: Bool[np.ndarray, " S"]
    """True for shapes that are only for testing."""
    drapes: dict[str, Float[np.ndarray, "S N 3"]]
    """Simulated vertices by fabric, metres; zero where neither good nor at rest, and at padding."""
    good: dict[str, Bool[np.ndarray, " S"]]
    """Which samples the rules keep."""
    target: Float[np.ndarray, "S N 3"]
    """Smoothed and averaged over all fabrics: what M_smooth is to be."""
    usable: Bool[np.ndarray, " S"]
    """Samples whose target may be learned: every fabric is at rest and at least one is good."""
    source: str = ""
    """The simulated garment whose drapes were carried over to this mesh (`carried`); empty where they are its own."""
    resting: dict[str, Bool[np.ndarray, " S"]] = field(default_factory=dict)
    """Which samples are at rest, good or not: where a garment is too tight for a body, no drape is good, but the
    simulation tells where it would hang."""

    @property
    def label(self) -> str:
        """The design's label."""
        return self.name.rsplit("-", 1)[0]

    @property
    def seed(self) -> int:
        """The topology's seed."""
        return int(self.name.rsplit("-", 1)[1])


_smooth = jax.jit(smooth)


def prepare_simulated(model: TryOnModel, root: Path, name: str) -> Garment:
    """The garment of a stored mesh with M̄ = W · R_mean(p).

    Args:
        model: Its configuration and R_mean.
        root: Folder of the dataset.
        name: <design label>-<topology seed>.
    """
    mesh = load_mesh(root, name)
    template = np.asarray(apply_mean_drape(model.mean, jnp.asarray(mesh["design"], jnp.float32)))
    vertices = np.einsum("vk,vkc->vc", mesh["template_weights"], template[mesh["template_vertices"]])
    config = model.config
    graph = build_graph(
        vertices,
        mesh["faces"],
        model.body,
        num_levels=config.num_levels,
        pooling=config.pooling,
        bucket=training_bucket(len(vertices)),
        pattern=mesh["start"],
        laplacian=config.laplacian,
    )
    size, count = graph.num_nodes, len(vertices)
    template_vertices, template_weights = np.zeros((size, 3), np.int32), np.zeros((size, 3), np.float32)
    template_vertices[:count], template_weights[:count] = mesh["template_vertices"], mesh["template_weights"]
    smoother = make_smoother(vertices, mesh["faces"], config.smoothing_length, size)
    design = mesh["design"].astype(np.float32)
    garment = Garment(graph, smoother, design, template_vertices, template_weights)
    if "uv" not in mesh or "faces_uv" not in mesh:
        # Packed data sets keep no pattern: training does not need it.
        return garment
    edges, rest = padded_edges(mesh["faces"], edge_lengths(mesh["uv"], mesh["faces_uv"]), count, size)
    return replace(garment, edges=edges, rest=rest)


def load_simulated(
    model: TryOnModel, root: Path, name: str, fabrics: Sequence[str], garment: Garment | None = None
) -> SimulatedGarment:
    """A garment with every drape that the dataset holds of it, test shapes included and marked.

    Args:
        model: Its configuration and R_mean.
        root: Folder of the dataset.
        name: <design label>-<topology seed>.
        fabrics: Names of the fabrics.
        garment: From `prepare_simulated`; made when None.

    Raises:
        FileNotFoundError: The garment's drape on the mean body is missing.
    """
    garment = garment or prepare_simulated(model, root, name)
    tables = {fabric: _samples(root, name, fabric) for fabric in fabrics}
    keys = sorted(set.union(*[set(table) for table in tables.values()]))
    size, count = garment.graph.num_nodes, garment.num_vertices
    betas = np.array(keys, np.float32)
    drapes, good, rests, resting = {}, {}, {}, np.ones(len(keys), bool)
    total = np.zeros((len(keys), size, 3), np.float32)
    for fabric, table in tables.items():
        stacked, keep, still = np.zeros_like(total), np.zeros(len(keys), bool), np.zeros(len(keys), bool)
        for i, key in enumerate(keys):
            sample = table.get(key)
            if sample is None:
                resting[i] = False
                continue
            total[i, :count] += sample.vertices / len(tables)
            resting[i] &= sample.resting
            keep[i], still[i] = sample.good, sample.resting
            if sample.good or sample.resting:
                stacked[i, :count] = sample.vertices
        drapes[fabric], good[fabric], rests[fabric] = stacked, keep, still
    test = np.array([next(t[key].test for t in tables.values() if key in t) for key in keys])
    # Fabrics differ by a centimetre. If one were left out of the average where its garment could not be put on, the
    # target would jump between body shapes, so its simulation counts here even if R_fine never sees it.
    usable = resting & np.any([good[f] for f in fabrics], axis=0)
    target = _smooth_all(garment.smoother, total)
    return SimulatedGarment(name, garment, betas, test, drapes, good, target, usable, resting=rests)


def load_cloth(root: Path, samples: SimulatedGarment) -> Cloth:
    """The garment's rest state, padded to its graph's bucket."""
    mesh = load_mesh(root, samples.name)
    size = samples.garment.graph.num_nodes
    return build_cloth(mesh["faces"], mesh["uv"], mesh["faces_uv"], len(mesh["start"]), bucket=size)


def _smooth_all(smoother: HeatSmoother, samples: np.ndarray) -> np.ndarray:
    # Smoothing is linear: the smoothed average is the average of the smoothed.
    columns = np.moveaxis(samples, 0, 1)
    return np.moveaxis(np.asarray(_smooth(smoother, jnp.asarray(columns))), 1, 0).copy()


class _Sample(NamedTuple):
    vertices: np.ndarray
    test: bool
    good: bool
    resting: bool


def _samples(root: Path, name: str, fabric: str) -> dict[tuple[float, ...], _Sample]:
    """Samples by betas."""
    found = load_drapes(root, name, fabric)
    parts = zip(found.betas, found.vertices, found.test, found.good, found.resting, strict=True)
    return {tuple(map(float, key)): _Sample(x, bool(t), bool(g), bool(r)) for key, x, t, g, r in parts}


def training_shapes(samples: SimulatedGarment, manifest: Manifest) -> Bool[np.ndarray, " S"]:
    """Which samples a training loop may see.

    Raises:
        PermissionError: the garment's design or topology is for testing.
    """
    simulated = samples.source or samples.name
    label, seed = simulated.rsplit("-", 1)
    if manifest.split(label, int(seed)) != "training" or (samples.source and samples.seed in manifest.test_seeds):
        raise PermissionError(f"{samples.name} is a test garment: it may not be trained on")
    return samples.usable & ~samples.test
