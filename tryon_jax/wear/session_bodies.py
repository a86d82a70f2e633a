"""The bodies of a session: the one that is dressed, its shapes, its measurements."""

from collections.abc import Mapping, Sequence
from functools import cached_property

import jax
import numpy as np
from jaxtyping import Float

from tryon_jax.body import MeasurementFit, betas_from_measurements, full_betas, shape_body
from tryon_jax.body.landmarks import Landmarks, load_landmarks
from tryon_jax.body.measurements import measure_vertices
from tryon_jax.graph.skinning import garment_skinning
from tryon_jax.tryon import TryOnModel
from tryon_jax.types import ArrayLike, Body
from tryon_jax.wear.dressed import ShapedBody
from tryon_jax.wear.gate import Verdict, judge_betas
from tryon_jax.wear.last_used import LastUsed
from tryon_jax.wear.other_body import OtherBody, prepare_other_body
from tryon_jax.wear.prepared import PreparedGarment
from tryon_jax.wear.stopwatch import Stopwatch

Betas = Float[ArrayLike, " b"] | Sequence[float]
"""At most `Session.num_betas` numbers, standard deviations; those left out are 0."""


class SessionBodies:
    """The body that a session dresses, in any shape; the base of `Session`."""

    def __init__(self, model: TryOnModel, body: Body | None, kept: int) -> None:
        """Prepare nothing but another body.

        Args:
            model: Networks and their body.
            body: A body to dress in place of the networks' own one.
            kept: Body shapes that are kept.

        Raises:
            ValueError: `body` is not closed, or lacks a joint or a landmark.
        """
        self.model = model
        self.other: OtherBody | None = (
            None if body is None else prepare_other_body(body, model.body, model.config.num_betas)
        )
        self.body = model.body if body is None else body
        self._vertices = jax.jit(lambda body, betas: shape_body(body, betas)[0])
        self._measure = jax.jit(measure_vertices)
        self._shapes: LastUsed[ShapedBody] = LastUsed(kept)

    @property
    def num_betas(self) -> int:
        """How many betas the body takes: those that the networks know, or all of another body."""
        return self.model.config.num_betas if self.other is None else self.body.num_betas

    @cached_property
    def landmarks(self) -> Landmarks:
        """Where tapes are laid on the body."""
        return load_landmarks(self.body) if self.other is None else self.other.landmarks

    def shape(self, betas: Betas = (), *, stopwatch: Stopwatch | None = None) -> ShapedBody:
        """The body with these betas and its measurements; the last ones are kept.

        Args:
            betas: At most `num_betas` numbers, standard deviations; those left out are 0.
            stopwatch: Takes the time of "body".

        Raises:
            ValueError: Too many betas, or values that are not finite or too far out.
        """
        with (stopwatch or Stopwatch()).stage("body"):
            every = full_betas(self.body, np.asarray(betas, np.float32).reshape(-1), self.num_betas)
            return self._shapes.get(every.tobytes(), lambda: self._shaped(every))

    def _shaped(self, betas: Float[np.ndarray, " b"]) -> ShapedBody:
        vertices = np.asarray(self._vertices(self.body, betas))
        measured = {name: float(value) for name, value in self._measure(vertices, self.landmarks).items()}
        known = betas if self.other is None else self.other.nearest_betas(vertices)
        return ShapedBody(self.body, betas, known, vertices, measured)

    def body_of(self, measurements: Mapping[str, float]) -> MeasurementFit:
        """The nearest body with these measurements among the shapes that `num_betas` betas can take.

        Args:
            measurements: Metres by name, see `body.measurements.MEASUREMENTS`.

        Raises:
            ValueError: An unknown name, or a value out of range.
        """
        return betas_from_measurements(self.body, measurements, self.landmarks, self.num_betas)

    def judge_body(self, body: ShapedBody) -> Verdict:
        """Whether the networks know bodies of this shape."""
        return judge_betas(body.known_betas, self.model.config.beta_ranges)

    def skinning(self, garment: PreparedGarment) -> Float[np.ndarray, "V J"]:
        """Skinning weights of the garment on the networks' body."""
        return garment_skinning(garment.garment.mean_vertices, garment.faces, self.model.body)
