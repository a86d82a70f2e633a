"""What each garment contributes to the training of a stage, and what of it chooses the weights."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from tryon_jax.garment.manifest import Manifest
from tryon_jax.nets.config import TryOnConfig
from tryon_jax.physics.cloth import Cloth
from tryon_jax.training.garments import SimulatedGarment, training_shapes
from tryon_jax.tryon import Garment, base_and_detail, fine_base

# Its scan would be compiled for every garment anew.
_base_and_detail = jax.jit(base_and_detail, static_argnums=0)


@dataclass(frozen=True, eq=False)
class StageSet:
    """What one garment contributes to a stage."""

    name: str
    garment: Garment
    betas: Float[np.ndarray, "S b"]
    inputs: Float[np.ndarray, "S N 3"] | None
    targets: Float[np.ndarray, "S N 3"]
    train: Bool[np.ndarray, " S"]
    validation: Bool[np.ndarray, " S"]
    cloth: Cloth | None = None
    """Rest state padded to the garment's bucket, where the loss has energies."""
    numbers: Float[np.ndarray, " F"] | None = None
    """Of the fabric, for an R_fine of all fabrics."""


def split_validation(samples: SimulatedGarment, manifest: Manifest, every: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Training shapes of a garment, less every sixteenth, which choose the weights (never the test shapes).

    All shapes of the manifest's validation designs do. Drapes that were carried over choose nothing.

    Args:
        samples: One garment.
        manifest: Splits of designs and topologies.
        every: Distance between two validation shapes.

    Returns:
        Masks [S] of the training and of the validation samples.

    Raises:
        PermissionError: The garment's design or topology is for testing.
    """
    allowed = training_shapes(samples, manifest)
    if samples.label in manifest.validation:
        return np.zeros_like(allowed), allowed
    validation = np.zeros_like(allowed)
    # Samples are sorted by betas: not the last ones, beyond which nothing is trained on.
    validation[np.flatnonzero(allowed)[every // 2 :: every]] = True
    train = allowed & ~validation
    return (train, np.zeros_like(validation)) if samples.source else (train, validation)


def smooth_sets(samples: Sequence[SimulatedGarment], manifest: Manifest) -> list[StageSet]:
    """R_smooth's samples: the smoothed simulations, averaged over fabrics."""
    sets = []
    for s in samples:
        train, validation = split_validation(s, manifest)
        sets.append(StageSet(s.name, s.garment, s.betas, None, s.target, train, validation))
    return sets


def fine_sets(
    samples: Sequence[SimulatedGarment],
    manifest: Manifest,
    fabric: str,
    smooth_vertices: Sequence[Float[np.ndarray, "S N 3"]] | None = None,
    cloths: Sequence[Cloth] | None = None,
    numbers: Float[np.ndarray, " F"] | None = None,
) -> list[StageSet]:
    """R_fine's samples for one fabric: the simulations themselves, given M_smooth of each sample.

    Args:
        samples: garments with their drapes.
        manifest: what may be trained on.
        fabric: which fabric's simulations.
        smooth_vertices: the predicted M_smooth; None for the smoothed simulation itself, the paper's form.
        cloths: rest states, where the loss has energies.
        numbers: of the fabric, for an R_fine of all fabrics.
    """
    sets = []
    for k, s in enumerate(samples):
        train, validation = split_validation(s, manifest)
        good = s.good[fabric]
        inputs = s.target if smooth_vertices is None else smooth_vertices[k]
        cloth = None if cloths is None else cloths[k]
        drapes = s.drapes[fabric]
        split = (train & good, validation & good)
        sets.append(StageSet(s.name, s.garment, s.betas, inputs, drapes, *split, cloth, numbers))
    return sets


def displacement_scale(config: TryOnConfig, sets: Sequence[StageSet]) -> float:
    """Root mean square of what the stage has to add, metres: the unit of its network's output."""
    squares, count = 0.0, 0
    for s in sets:
        chosen = np.flatnonzero(s.train)[:: max(1, int(s.train.sum()) // 8)]
        mask = np.asarray(s.garment.graph.mask)
        squares += float((displacements(config, s, chosen)[:, mask] ** 2).sum())
        count += len(chosen) * int(mask.sum()) * 3
    return float(np.sqrt(squares / max(count, 1)))


def displacements(config: TryOnConfig, s: StageSet, rows: Int[np.ndarray, " R"]) -> Float[np.ndarray, "R N 3"]:
    """What the stage has to add in some samples of a garment, metres.

    Args:
        config: Of the model.
        s: The garment's samples.
        rows: Which of them.
    """
    base, detail = _base_and_detail(config, s.garment)
    start = np.asarray(base)[None] if s.inputs is None else s.inputs[rows] + np.asarray(fine_base(config, detail))[None]
    return s.targets[rows] - start
