"""Training R_smooth and R_fine on simulated garments (sections 4.2 and 4.3 of the paper).

Both minimise the displacement error over the vertices of a batch that mixes designs, topologies and shapes; one set of
weights serves them all. R_fine learns what is left after the *predicted* M_smooth, so that it also mends R_smooth's
errors; `fine_input="smoothed"` is the paper's form, the simulation minus its smoothed self.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.garment.manifest import Manifest
from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.kriging import Kriging
from tryon_jax.nets.mlp import MLP
from tryon_jax.nets.unet import UNet
from tryon_jax.physics.bending import bending_energy
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.state import GRAVITY
from tryon_jax.physics.stretch import stretch_energy
from tryon_jax.training.garments import SimulatedGarment, training_shapes
from tryon_jax.tryon import (
    Garment,
    Stage,
    array_shapes,
    base_and_detail,
    fine_base,
    fine_stage,
    of_fabric,
    smooth_stage,
    stack_garments,
)
from tryon_jax.types import ArrayLike, pytree

FineInput = Literal["predicted", "smoothed"]
Distance = Literal["squared", "plain"]
ROUNDED = 1e-4
"""Below this the plain distance is rounded off, so that its gradient stays finite; metres."""
CHUNK = 16
"""Shapes of one garment that are predicted at once."""
# Its scan would be compiled for every garment anew.
_base_and_detail = jax.jit(base_and_detail, static_argnums=0)


@pytree
class StageWeights:
    """What training changes of a stage."""

    net: UNet
    coefficients: MLP | None = None
    """None where they stay as they are, and in the paper's form."""

    def of(self, stage: Stage) -> Stage:
        """The stage with these weights."""
        return replace(stage, net=self.net, coefficients=self.coefficients or stage.coefficients)


@pytree
class StageBatch:
    """G garments of one bucket, B shapes each."""

    BY_SHAPE = ("betas", "inputs", "targets")  # axis 1 is B: what `parallel` splits over devices

    garments: Garment
    """Stacked along a leading axis G."""
    betas: Float[ArrayLike, "G B b"]
    inputs: Float[ArrayLike, "G B N 3"]
    """M_smooth as R_fine sees it; zeros for R_smooth, which does not use it."""
    targets: Float[ArrayLike, "G B N 3"]
    """Vertices to be predicted, metres."""
    numbers: Float[ArrayLike, "G F"] | None = None
    """Of each garment's fabric, for an R_fine of all fabrics."""
    cloth: Cloth | None = None
    """Rest states along the leading axis, where the loss has energies."""


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


def predict(
    config: TryOnConfig, kind: str, stage: Stage | Kriging, garment: Garment, betas: Array, inputs: Array
) -> Float[Array, "B N 3"]:
    """The stage's output, "smooth" or "fine", by the functions that `drape` calls.

    Args:
        config: Of the model.
        kind: "smooth" or "fine".
        stage: Network and scale; for "smooth" also kriged drapes.
        garment: One garment.
        betas: Body shapes, standard deviations.
        inputs: M_smooth [B, N, 3] for "fine", metres; not read for "smooth".

    Returns:
        Vertices, metres.
    """
    if kind == "smooth":
        return smooth_stage(config, stage, garment, betas)
    assert isinstance(stage, Stage)
    return fine_stage(config, stage, garment, betas, inputs)


def stage_loss(
    config: TryOnConfig,
    kind: str,
    stage: Stage,
    batch: StageBatch,
    distance: Distance = "squared",
    energy: float = 0.0,
    fabric: Fabric | None = None,
) -> Float[Array, ""]:
    """Mean vertex error over the stage's scale (dimensionless), every drape alike.

    Args:
        config: of the model.
        kind: "smooth" or "fine".
        stage: network and scale.
        batch: samples.
        distance: see `displacement_error`.
        energy: weight of the cloth's energy of the prediction, see `relative_energy`.
        fabric: the stage's fabric, where there is such a weight.
    """
    predicted = map_garments(
        lambda g, b, i, n: predict(config, kind, of_fabric(stage, n), g, b, i),
        batch.garments,
        batch.betas,
        batch.inputs,
        batch.numbers,
    )
    mask = jnp.asarray(batch.garments.graph.mask)
    scale = jax.lax.stop_gradient(jnp.asarray(stage.scale))
    loss = displacement_error(predicted, jnp.asarray(batch.targets), mask, scale, distance)
    if energy and fabric is not None and batch.cloth is not None:
        many = jax.vmap(jax.vmap(relative_energy, (0, None, None)), (0, 0, None))
        loss = loss + energy * many(predicted, batch.cloth, fabric).mean()
    return loss


def displacement_error(
    predicted: Float[Array, "G B N 3"],
    targets: Float[Array, "G B N 3"],
    mask: Bool[Array, "G N"],
    scale: Float[Array, ""],
    distance: Distance,
) -> Float[Array, ""]:
    """Mean error over the scale (dimensionless), over a garment's vertices first, so that every drape counts alike.

    Args:
        predicted: vertices, metres.
        targets: where they should be, metres.
        mask: which are no padding.
        scale: unit of length, metres.
        distance: squared: the mean square of a coordinate's error. plain: the mean distance, the ℓ²-norm of each
            vertex's error, which weights large errors less: where cloth may fold in two ways, the mean of the two,
            which is no fold, has the smallest squared error.
    """
    error = jnp.where(mask[:, None, :, None], predicted - targets, 0.0) / scale
    squares = (error * error).sum(axis=3)
    if distance == "squared":
        of_vertices = squares / 3
    else:
        rounded = ROUNDED / scale
        of_vertices = jnp.sqrt(squares + rounded * rounded) - rounded
    return (of_vertices.sum(axis=2).mean(axis=1) / mask.sum(axis=1)).mean()


def map_garments(function: Callable[..., Array], *batch: Any) -> Array:
    """`jax.vmap` over leading axes; a single garment needs none of what makes several look like one."""
    if jax.tree.leaves(batch)[0].shape[0] > 1:
        return jax.vmap(function)(*batch)
    return function(*jax.tree.map(lambda leaf: leaf[0], batch))[None]


def relative_energy(vertices: Float[Array, "N 3"], cloth: Cloth, fabric: Fabric) -> Float[Array, ""]:
    """Stretch, bending and gravity of a drape over its weight (metres: how high the energy would lift it), times 1/mm.

    The simulator's equilibrium is a minimum of it under contact, where the mean over many equilibria is none.

    Args:
        vertices: The drape, metres.
        cloth: Rest state.
        fabric: Material.
    """
    mass = jnp.asarray(cloth.vertex_areas) * fabric.density
    stored = stretch_energy(vertices, cloth, fabric) + bending_energy(vertices, cloth, fabric)
    lifted = (mass * vertices[:, 1]).sum() * GRAVITY
    return 1e3 * (stored + lifted) / (mass.sum() * GRAVITY)


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


class BatchSource:
    """Draws batches of garments whose arrays have the same shapes, as those of a bucket, in proportion to them."""

    def __init__(
        self,
        sets: Sequence[StageSet],
        garments: int,
        shapes: int,
        no_design: Float[np.ndarray, " P"] | None = None,
        dropout: float = 0.0,
    ) -> None:
        """Draw batches from these samples.

        Args:
            sets: Samples of each garment.
            garments: Garments of a batch.
            shapes: Shapes of each.
            no_design: Design that takes the place of a garment's own one, metres.
            dropout: Share of the garments drawn whose design is replaced.
        """
        self.shapes, self.garments, self.no_design, self.dropout = shapes, garments, no_design, dropout
        self.sets = [s for s in sets if s.train.any()]
        if not self.sets:
            raise ValueError("no garment of the dataset has a good training sample")
        self._groups: dict[tuple[tuple[int, ...], ...], list[StageSet]] = {}
        for s in self.sets:
            self._groups.setdefault(array_shapes(s.garment), []).append(s)

    def draw(self, rng: np.random.Generator) -> StageBatch:
        """One batch."""
        first = self.sets[rng.integers(len(self.sets))]
        group = self._groups[array_shapes(first.garment)]
        others = [group[i] for i in rng.integers(len(group), size=self.garments - 1)]
        chosen = [first, *others]
        picks = [rng.choice(np.flatnonzero(s.train), self.shapes) for s in chosen]
        nothing = np.zeros((1, 1, 3), np.float32)
        return StageBatch(
            stack_garments([self._with_or_without_design(s.garment, rng) for s in chosen]),
            np.stack([s.betas[p] for s, p in zip(chosen, picks, strict=True)]),
            np.stack(
                [
                    np.broadcast_to(nothing, s.targets[p].shape) if s.inputs is None else s.inputs[p]
                    for s, p in zip(chosen, picks, strict=True)
                ]
            ),
            np.stack([s.targets[p] for s, p in zip(chosen, picks, strict=True)]),
            stacked_numbers([s.numbers for s in chosen]),
            self._cloths(chosen),
        )

    def _with_or_without_design(self, garment: Garment, rng: np.random.Generator) -> Garment:
        if self.no_design is None or garment.design is None or rng.random() >= self.dropout:
            return garment
        return replace(garment, design=self.no_design.astype(np.float32))

    @staticmethod
    def _cloths(chosen: Sequence[StageSet]) -> Cloth | None:
        cloths = [s.cloth for s in chosen]
        if any(cloth is None for cloth in cloths):
            return None
        return jax.tree.map(lambda *arrays: np.stack([np.asarray(a) for a in arrays]), *cloths)


def stacked_numbers(rows: Sequence[Float[np.ndarray, " F"] | None]) -> Float[np.ndarray, "G F"] | None:
    """Numbers of the fabrics of G garments; None where the R_fine of one fabric sees none."""
    there = [row for row in rows if row is not None]
    return np.stack(there) if there else None


class Predictor:
    """A stage's predictions for many samples of a garment, in chunks, compiled once for each bucket."""

    def __init__(self, config: TryOnConfig, kind: str) -> None:
        self._run = jax.jit(lambda stage, garment, betas, inputs: predict(config, kind, stage, garment, betas, inputs))

    def __call__(
        self,
        stage: Stage | Kriging,
        garment: Garment,
        betas: Float[np.ndarray, "S b"],
        inputs: np.ndarray | None = None,
    ) -> Float[np.ndarray, "S N 3"]:
        """Predicted vertices, padded, metres.

        Args:
            stage: Network and scale.
            garment: One garment.
            betas: Body shapes, standard deviations.
            inputs: M_smooth for R_fine, metres.
        """
        out = []
        for start in range(0, len(betas), CHUNK):
            rows = np.arange(start, start + CHUNK) % len(betas)
            given = np.zeros((CHUNK, 1, 3), np.float32) if inputs is None else inputs[rows]
            out.append(np.asarray(self._run(stage, garment, betas[rows], given))[: len(betas) - start])
        return np.concatenate(out)


def validation_error(predictor: Predictor, stage: Stage | Kriging, sets: Sequence[StageSet], most: int = 8) -> float:
    """Mean distance from the targets over validation samples (at most `most` of each garment), millimetres.

    Garments with training samples and designs that have none count half each: users ask for new designs as often.

    Args:
        predictor: Compiled prediction.
        stage: Network and scale, or kriged drapes.
        sets: Samples of each garment.
        most: Samples of each garment at most.
    """
    errors: dict[bool, list[float]] = {}
    for s in sets:
        chosen = np.flatnonzero(s.validation)
        chosen = chosen[:: max(1, len(chosen) // most)][:most]
        if not len(chosen):
            continue
        inputs = None if s.inputs is None else s.inputs[chosen]
        bound = of_fabric(stage, s.numbers) if isinstance(stage, Stage) else stage
        predicted = predictor(bound, s.garment, s.betas[chosen], inputs)
        mask = np.asarray(s.garment.graph.mask)
        error = 1e3 * np.linalg.norm((predicted - s.targets[chosen])[:, mask], axis=-1).mean()
        errors.setdefault(bool(s.train.any()), []).append(float(error))
    return float(np.mean([np.mean(group) for group in errors.values()]))
