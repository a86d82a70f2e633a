"""Batches of training samples: garments of one size, some body shapes of each."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float

from tryon_jax.physics.cloth import Cloth
from tryon_jax.training.stage_sets import StageSet
from tryon_jax.tryon import Garment, array_shapes, stack_garments
from tryon_jax.types import ArrayLike, pytree


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
            dropout: Share of the garments drawn whose design is replaced, and whose place on the pattern is forgotten.
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
        known = garment.template_weights
        without = None if known is None else np.zeros_like(known)
        return replace(garment, design=self.no_design.astype(np.float32), template_weights=without)

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
