"""What a stage predicts, as `drape` does, and how far that is from the validation samples."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.kriging import Kriging
from tryon_jax.training.stage_sets import StageSet
from tryon_jax.tryon import Garment, Stage, fine_stage, of_fabric, smooth_stage

CHUNK = 16
"""Shapes of one garment that are predicted at once."""


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
