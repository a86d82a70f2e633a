"""The fully connected baseline: one dense mesh for all garments, and a network from (p, β) to all of its vertices."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, PRNGKeyArray
from tqdm import tqdm

from experiments.shared.evaluate import Stack
from experiments.shared.neighbours import load_drapes
from tryon_jax.garment import dense_template
from tryon_jax.garment.design import Design
from tryon_jax.garment.manifest import Manifest
from tryon_jax.garment.mesh import SewnMesh
from tryon_jax.garment.pattern_map import PatternMap, map_patterns, pattern_arrays
from tryon_jax.nets.mlp import MLP, apply_mean_drape, apply_mlp, init_mlp
from tryon_jax.training.dataset import load_arrays, mesh_path
from tryon_jax.training.loop import LoopOptions, LoopResult, train_loop
from tryon_jax.tryon import TryOnModel, config_space

VALIDATION_EVERY = 8
"""Every so-many-th training shape of a garment chooses the weights, as for the graph networks."""
FIRST_GAIN = 10.0
"""Of the first layer's weights over Glorot's, see `init_dense`."""
_CHUNK = 32
Layers = tuple[tuple[Any, ...], tuple[Any, ...]]
"""Weights and biases of an `MLP`, as plain tuples for the optimiser."""


@dataclass(frozen=True, eq=False)
class DenseGarment:
    """A design on the dense mesh."""

    mesh: SewnMesh
    mean: Float[np.ndarray, "N 3"]
    """M̄ at the dense vertices, metres: what displacements are added to."""
    design: Float[np.ndarray, " P"]
    """Design parameters, −1 to 1 over their ranges."""


class DenseMeshes:
    """Dense meshes by design; their connectivity is the same for all, so that one network can predict them."""

    def __init__(self, model: TryOnModel, manifest: Manifest, num_vertices: int) -> None:
        self.model, self.manifest, self.num_vertices = model, manifest, num_vertices
        self._made: dict[str, DenseGarment] = {}

    def __call__(self, label: str) -> DenseGarment:
        """The dense garment of a design of the manifest."""
        if label not in self._made:
            self._made[label] = self._make(self.manifest.design(label))
        return self._made[label]

    def _make(self, design: Design) -> DenseGarment:
        space = config_space(self.model.config)
        dense = dense_template(space, design, self.num_vertices)
        onto = map_patterns(pattern_arrays(dense.mesh), pattern_arrays(dense.template))
        template = np.asarray(apply_mean_drape(self.model.mean, jnp.asarray(design.values, jnp.float32)))
        scaled = (np.asarray(design.values) - space.mean) / (0.5 * (space.maximum - space.minimum))
        return DenseGarment(dense.mesh, onto(template[None])[0].astype(np.float32), scaled.astype(np.float32))

    def onto(self, root: Path, name: str) -> PatternMap:
        """Where the dense vertices lie on the simulated mesh of a garment: moves its drapes to the dense mesh."""
        dense = self(name.rsplit("-", 1)[0])
        return map_patterns(pattern_arrays(dense.mesh), load_arrays(mesh_path(root, name)))

    def back(self, root: Path, name: str) -> PatternMap:
        """Where the vertices of a simulated mesh lie on the dense one."""
        dense = self(name.rsplit("-", 1)[0])
        return map_patterns(load_arrays(mesh_path(root, name)), pattern_arrays(dense.mesh))


@dataclass(frozen=True, eq=False)
class DenseSamples:
    """Training samples of one simulated garment; its drapes are moved to the dense mesh when they are drawn."""

    garment: DenseGarment
    onto: PatternMap
    betas: Float[np.ndarray, "S b"]
    drapes: Stack
    train: Int[np.ndarray, " K"]
    validation: Int[np.ndarray, " L"]

    def inputs(self, rows: np.ndarray) -> Float[np.ndarray, "S i"]:
        """(p, β) of some samples, as the network sees them."""
        return dense_inputs(self.garment.design, self.betas[rows])

    def targets(self, rows: np.ndarray) -> Float[np.ndarray, "S N 3"]:
        """Their displacements from M̄ at the dense vertices, metres."""
        return (self.onto(self.drapes[rows]) - self.garment.mean[None]).astype(np.float32)


def dense_inputs(design: Float[np.ndarray, " P"], betas: Float[np.ndarray, "S b"]) -> Float[np.ndarray, "S i"]:
    """Normalised design parameters and betas of the same size, side by side."""
    return np.concatenate([np.broadcast_to(design, (len(betas), len(design))), betas / 2.0], axis=1).astype(np.float32)


def load_samples(meshes: DenseMeshes, root: Path, names: Sequence[str], fabric: str) -> list[DenseSamples]:
    """Training samples of garments.

    Raises:
        PermissionError: a garment's design or topology is for testing.
    """
    found = []
    for name in tqdm(names, desc="dense meshes", mininterval=2):
        label, seed = name.rsplit("-", 1)
        if meshes.manifest.split(label, int(seed)) != "training":
            raise PermissionError(f"{name} is a test garment: it may not be trained on")
        drapes = load_drapes(meshes.model, root, name, fabric)
        allowed = np.flatnonzero(drapes.good & ~drapes.test)
        held = np.arange(len(allowed)) % VALIDATION_EVERY == VALIDATION_EVERY - 1
        held |= label in meshes.manifest.validation
        if len(allowed):
            onto = meshes.onto(root, name)
            found.append(
                DenseSamples(meshes(label), onto, drapes.betas, drapes.vertices, allowed[~held], allowed[held])
            )
    if not found:
        raise ValueError(f"no training garment has a good drape in {fabric!r}")
    return found


@dataclass(frozen=True, eq=False)
class DenseNetwork:
    """A trained baseline."""

    mlp: MLP
    scale: float
    """Displacements are scale · output, metres."""

    def __call__(self, garment: DenseGarment, betas: Float[np.ndarray, "S b"]) -> Stack:
        """Drapes of a garment at the dense vertices, metres."""
        inputs = jnp.asarray(dense_inputs(garment.design, betas))
        parts = [np.asarray(_apply(self.mlp, inputs[k : k + _CHUNK])) for k in range(0, len(betas), _CHUNK)]
        return garment.mean[None] + self.scale * np.concatenate(parts).reshape(len(betas), -1, 3)


_apply = jax.jit(apply_mlp)


def init_dense(key: PRNGKeyArray, layers: Sequence[int]) -> MLP:
    """Glorot's weights, larger in the first layer, so that its units bend over the range of the inputs.

    Glorot's layer from five inputs to hundreds of units keeps them all linear in design and betas, and training stops
    near the best linear map.
    """
    start = init_mlp(key, layers)
    return MLP((FIRST_GAIN * start.weights[0], *start.weights[1:]), start.biases)


def train_dense(
    samples: Sequence[DenseSamples],
    layers: Sequence[int],
    folder: Path,
    options: LoopOptions,
    batch: int,
    identity: Mapping[str, Any],
) -> tuple[DenseNetwork, LoopResult]:
    """Fit the network by AdamW on mini-batches of samples, all garments mixed; resumes from what `folder` holds."""
    pairs = [(g, row) for g, s in enumerate(samples) for row in s.train]
    scale = _root_mean_square(samples)

    def gather(chosen: Sequence[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
        inputs = [samples[g].inputs(np.array([row])) for g, row in chosen]
        targets = [samples[g].targets(np.array([row])) for g, row in chosen]
        return np.concatenate(inputs), np.concatenate(targets).reshape(len(chosen), -1) / np.float32(scale)

    def draw(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return gather([pairs[k] for k in rng.integers(len(pairs), size=batch)])

    def loss(layers: Layers, drawn: tuple[jax.Array, jax.Array]) -> jax.Array:
        error = apply_mlp(MLP(*layers), drawn[0]) - drawn[1]
        return (error * error).mean()

    held = [(g, row) for g, s in enumerate(samples) for row in s.validation[:4]] or pairs[:4]

    def evaluate(layers: Layers) -> float:
        mlp, errors = MLP(*layers), []
        for start in range(0, len(held), _CHUNK):
            inputs, targets = gather(held[start : start + _CHUNK])
            apart = (np.asarray(_apply(mlp, jnp.asarray(inputs))) - targets).reshape(len(inputs), -1, 3)
            errors += (1e3 * scale * np.linalg.norm(apart, axis=-1).mean(axis=1)).tolist()
        return float(np.mean(errors))

    complete = {**identity, "layers": list(layers), "batch": batch, "options": asdict(options), "scale": scale}
    start = init_dense(jax.random.key(options.seed), layers)
    result = train_loop(
        (start.weights, start.biases), loss, draw, evaluate, folder, options, complete, "fully connected"
    )
    return DenseNetwork(MLP(*result.params), scale), result


def _root_mean_square(samples: Sequence[DenseSamples]) -> float:
    squares = [float((s.targets(s.train[:: max(1, len(s.train) // 4)]) ** 2).mean()) for s in samples if len(s.train)]
    return float(np.sqrt(np.mean(squares)))
