"""Prediction without networks: training drapes interpolated over designs and body shapes at once by kriging.

Every drape is a field of displacements from the mean drape. Read at the same places of the template, the fields of all
training samples are regressed on design and betas by a Gaussian process with one kernel for all coordinates, so that a
prediction is a weighted sum of training drapes. The lengths of the kernel are those that predict the validation designs
best; these are not fitted, as for the networks.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from experiments.shared.evaluate import Stack
from experiments.shared.neighbours import Drapes, distance_weights
from tryon_jax.garment.manifest import Manifest
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.protocol import EXTENT

EVERY = 3
"""Of the fitted garment with the most vertices, one vertex of so many is a place where fields are read: some 3 cm
apart."""
BLENDED = 4
"""Vertices that are blended where a field is read."""


@dataclass(frozen=True)
class Kernel:
    """A squared exponential over designs and body shapes."""

    design: float
    """Length, in half ranges of the parameters."""
    shape: float
    """Length, in half axes of what the dataset covers."""
    nugget: float
    """Variance that no neighbour shares, over the variance that all share."""


KERNELS = tuple(Kernel(*values) for values in product((0.5, 0.8, 1.2), (0.5, 0.7, 1.0, 1.6), (0.004, 0.02, 0.1)))
"""Those that are tried."""


class KrigedGarments:
    """The training drapes of one fabric, kriged over designs and body shapes."""

    def __init__(
        self,
        garments: Sequence[Drapes],
        manifest: Manifest,
        template: Float[np.ndarray, "T 3"],
        kernels: Sequence[Kernel] = KERNELS,
    ) -> None:
        """Read the training shapes of `garments` at common places and choose the kernel.

        Args:
            garments: Simulated garments that may be trained on; validation designs among them choose the kernel.
            manifest: Splits of designs and topologies.
            template: The mean design's mean drape, metres: where a vertex of any design lies on it is its place.
            kernels: To choose from; the first is taken where no validation design is known.

        Raises:
            PermissionError: A garment's design or topology is for testing.
            ValueError: No garment is left to fit.
        """
        self._template = template
        self._centre, self._half = manifest.space.mean, 0.5 * (manifest.space.maximum - manifest.space.minimum)
        fitted, held = [], []
        for drapes in garments:
            label, seed = drapes.name.rsplit("-", 1)
            if manifest.split(label, int(seed)) != "training":
                raise PermissionError(f"{drapes.name} is a test garment: nothing may be learned from it")
            (held if label in manifest.validation else fitted).append(drapes)
        if not fitted:
            raise ValueError("kriging needs at least one garment that is fitted")
        self._places = max((self._of(drapes) for drapes in fitted), key=len)[::EVERY]
        self._codes, self._fields = self._read(fitted)
        self._fields_mean = self._fields.mean(axis=0)
        self.kernel = kernels[0]
        codes, fields = self._read(held) if held else (self._codes[:0], self._fields[:0])
        if len(codes) and len(kernels) > 1:
            errors = []
            for kernel in kernels:
                missed = (self._predict(codes, kernel, self._duals(kernel)) - fields).reshape(len(codes), -1, 3)
                errors.append(float(np.linalg.norm(missed, axis=-1).mean()))
            self.kernel = kernels[int(np.argmin(errors))]
        self._dual = self._duals(self.kernel)

    def __call__(self, samples: SimulatedGarment, rows: np.ndarray) -> Stack:
        """Drapes of a garment at the shapes of its samples `rows`, metres.

        Args:
            samples: A garment that was cut from a design.
            rows: Samples whose body shapes are wanted.
        """
        garment, mean = samples.garment, samples.garment.mean_vertices
        corners, shares = np.asarray(garment.template_vertices), np.asarray(garment.template_weights)
        places = np.einsum("vk,vkc->vc", shares[: len(mean)], self._template[corners[: len(mean)]])
        fields = self.fields(np.asarray(garment.design), samples.betas[rows])
        index, weights = blend(self._places, places)
        return mean[None] + np.einsum("vk,svkc->svc", weights, fields[:, index], optimize=True).astype(np.float32)

    def fields(self, design: Float[np.ndarray, " P"], betas: Float[np.ndarray, "S b"]) -> Float[np.ndarray, "S Q 3"]:
        """Displacements at the common places, metres.

        Args:
            design: Parameters of one design, metres.
            betas: Body shapes.
        """
        return self._predict(self._code(design, betas), self.kernel, self._dual).reshape(len(betas), -1, 3)

    def _of(self, drapes: Drapes) -> Float[np.ndarray, "V 3"]:
        """Places of a simulated garment's vertices."""
        return np.einsum("vk,vkc->vc", drapes.template_weights, self._template[drapes.template_vertices])

    def _code(self, design: np.ndarray, betas: np.ndarray) -> Float[np.ndarray, "S c"]:
        """Designs in half ranges and body shapes in half axes."""
        scaled = np.broadcast_to((design - self._centre) / self._half, (len(betas), len(self._half)))
        return np.concatenate([scaled, betas / np.array(EXTENT[: betas.shape[1]])[None]], axis=1)

    def _read(self, garments: Sequence[Drapes]) -> tuple[Float[np.ndarray, "S c"], Float[np.ndarray, "S D"]]:
        """Codes and displacements at the common places of all good training shapes."""
        codes, fields = [], []
        for drapes in garments:
            rows = np.flatnonzero(drapes.good & ~drapes.test)
            if not len(rows):
                continue
            index, weights = blend(self._of(drapes), self._places)
            moved = (drapes.vertices[rows] - drapes.mean[None])[:, index]
            fields.append(np.einsum("pk,spkc->spc", weights, moved, optimize=True).reshape(len(rows), -1))
            codes.append(self._code(drapes.design, drapes.betas[rows]))
        if not codes:
            raise ValueError("kriging needs at least one good drape")
        return np.concatenate(codes), np.concatenate(fields).astype(np.float32)

    def _duals(self, kernel: Kernel) -> Float[np.ndarray, "S D"]:
        """What the covariances with the training samples weight."""
        here = self._covariance(self._codes, self._codes, kernel)
        here[np.diag_indices(len(here))] += kernel.nugget
        factor = scipy.linalg.cho_factor(here, lower=True, overwrite_a=True, check_finite=False)
        return scipy.linalg.cho_solve(factor, self._fields - self._fields_mean, check_finite=False).astype(np.float32)

    def _predict(
        self, codes: Float[np.ndarray, "N c"], kernel: Kernel, duals: Float[np.ndarray, "S D"]
    ) -> Float[np.ndarray, "N D"]:
        """Displacements at the common places."""
        return self._fields_mean + self._covariance(codes, self._codes, kernel).astype(np.float32) @ duals

    def _covariance(self, one: np.ndarray, other: np.ndarray, kernel: Kernel) -> Float[np.ndarray, "N M"]:
        count = len(self._half)
        lengths = np.concatenate([np.full(count, kernel.design), np.full(one.shape[1] - count, kernel.shape)])
        return np.exp(-0.5 * cdist(one / lengths, other / lengths, "sqeuclidean"))


def blend(
    vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "P 3"]
) -> tuple[Int[np.ndarray, "P k"], Float[np.ndarray, "P k"]]:
    """The closest vertices to each point and their weights, which sum to 1.

    Args:
        vertices: To read at, metres.
        points: Where to read.
    """
    distance, index = cKDTree(vertices).query(points, k=np.arange(1, min(BLENDED, len(vertices)) + 1))
    return index, distance_weights(distance)
