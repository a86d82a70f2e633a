"""Fitting the kriged drapes of one fabric to simulated garments (host side).

The coordinates of all drapes in their principal components are regressed on design and body shape. R_fine then learns
what kriging leaves. For a design that was fitted, that is what kriging leaves when it is fitted without this design:
otherwise R_fine would be told too little of the error at new ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Float, Int
from scipy.sparse.linalg import eigsh
from tqdm import tqdm

from tryon_jax.garment.manifest import Manifest
from tryon_jax.nets.kriging import Kriging, KrigingConfig, ShapeFunctions
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.kernel_choice import choose_functions
from tryon_jax.training.node_drapes import NodeDrapes, NodeReader, rows_of
from tryon_jax.training.stage_prediction import Predictor, validation_error
from tryon_jax.training.stage_sets import fine_sets
from tryon_jax.tryon import TryOnModel, base_and_detail, fine_base

FREE = 1e-3
"""Ridge of the trend's functions over the nugget: as good as none, but enough where few drapes tell them."""
STEP = 2.0**-15
"""Components are rounded to so many metres: files compress to a third of their size, and drapes change by 0.1 mm."""
WEIGHT_STEP = 8e-5
"""Weights are rounded to multiples of a power of two, one for each component, that moves nodes by so many metres at
most; drapes change by another 0.2 mm."""

_base_and_detail = jax.jit(base_and_detail, static_argnums=0)


class KrigingFit:
    """A process fitted to drapes, and what it would be without some of them."""

    def __init__(self, drapes: NodeDrapes, config: KrigingConfig) -> None:
        """Fit: principal components, then ridge regression, the nugget being the ridge of the kernel's functions.

        Args:
            drapes: What to fit.
            config: Of the process.
        """
        self.rows = drapes.rows
        self._mean = drapes.fields.mean(axis=0)
        centred = drapes.fields - self._mean[None]
        self._basis = principal_components(centred, config.components)
        self.coordinates = (centred @ self._basis).astype(np.float64)
        self._chosen = choose_functions(drapes, config)
        self.functions = self._chosen(drapes)
        normal = self.functions.T @ self.functions
        trend = (1 + drapes.designs.shape[1]) * (1 + drapes.shapes.shape[1])
        self.ridge = np.full(len(normal), config.nugget)
        self.ridge[-trend:] *= FREE
        normal[np.diag_indices(len(normal))] += self.ridge
        self._factor = scipy.linalg.cho_factor(normal, lower=True)
        self._weights = scipy.linalg.cho_solve(self._factor, self.functions.T @ self.coordinates)
        self._left = self.coordinates - self.functions @ self._weights
        spread = np.maximum(np.sqrt((self.coordinates**2).mean(axis=0)), 1e-9)
        components = np.rint(self._basis * spread[None] / STEP) * STEP
        steps = 2.0 ** np.floor(np.log2(WEIGHT_STEP * np.sqrt(self._basis.shape[0] / 3) / spread))
        weights = self._weights / spread[None]
        weights[:-trend] = np.rint(weights[:-trend] / steps[None]) * steps[None]
        arrays = (self._mean.reshape(-1, 3), components.T.reshape(config.components, -1, 3), weights)
        mean, components, weights, middle, half, extent = (
            jnp.asarray(array, jnp.float32) for array in (*arrays, drapes.middle, drapes.half, drapes.extent)
        )
        chosen = self._chosen
        of_design, of_shape = (jnp.asarray(index) for index in chosen.pairs)
        self.kriging = Kriging(
            edges=jnp.asarray(drapes.edges),
            mean=mean,
            components=components,
            weights=weights,
            design_center=middle,
            design_scale=half,
            designs=chosen.designs,
            of_design=of_design,
            of_shape=of_shape,
            shapes=ShapeFunctions(extent, chosen.shapes),
        )

    def predict(self, drapes: NodeDrapes) -> Float[np.ndarray, "S D"]:
        """What the process says of other drapes, metres.

        Args:
            drapes: Their designs and body shapes.
        """
        functions = self._chosen(drapes)
        return self._mean[None] + (functions @ self._weights).astype(np.float32) @ self._basis.T

    def without(self, rows: Int[np.ndarray, " R"]) -> Float[np.ndarray, "R Q 3"]:
        """Fields that the process would predict for some of its samples if it had been fitted without them, metres.

        The residual without a block is (I − H)⁻¹ times that with it, H being the block of the hat matrix.

        Args:
            rows: Samples, in the order in which they were read.
        """
        functions = self.functions[rows]
        hat = functions @ scipy.linalg.cho_solve(self._factor, functions.T)
        left = np.linalg.solve(np.eye(len(rows)) - hat, self._left[rows])
        fields = self._mean[None] + (self.coordinates[rows] - left).astype(np.float32) @ self._basis.T
        return fields.reshape(len(rows), -1, 3)

    def without_each_design(self) -> dict[str, Float[np.ndarray, "R Q 3"]]:
        """For each garment, its fields as `without` all drapes of its design, metres."""
        of_design: dict[str, list[str]] = {}
        for name in self.rows:
            of_design.setdefault(name.rsplit("-", 1)[0], []).append(name)
        fields: dict[str, Float[np.ndarray, "R Q 3"]] = {}
        for names in of_design.values():
            left_out = self.without(np.concatenate([self.rows[name] for name in names]))
            ends = np.cumsum([len(self.rows[name]) for name in names])[:-1]
            fields |= dict(zip(names, np.split(left_out, ends), strict=True))
        return fields


def principal_components(centred: Float[np.ndarray, "S D"], count: int) -> Float[np.ndarray, "D R"]:
    """The leading principal components of rows without their mean; zeros where there are fewer, or rows do not vary.

    Args:
        centred: Rows.
        count: Components R.
    """
    gram = (centred.T @ centred).astype(np.float64)
    kept = min(count, len(centred), len(gram))
    basis = np.zeros((len(gram), count), np.float32)
    if not gram.any():
        return basis
    if 4 * kept < len(gram):
        # A few of many: Lanczos takes a fifth of the time, and is exact to rounding.
        vectors = eigsh(gram, k=kept, v0=np.random.default_rng(0).standard_normal(len(gram)))[1]
    else:
        vectors = scipy.linalg.eigh(gram, subset_by_index=[len(gram) - kept, len(gram) - 1])[1]
    basis[:, :kept] = vectors[:, ::-1]
    return basis


def kriged_starts(
    model: TryOnModel,
    kriging: Kriging,
    left_out: Mapping[str, Float[np.ndarray, "R Q 3"]],
    samples: Sequence[SimulatedGarment],
    manifest: Manifest,
    fabric: str,
) -> list[Float[np.ndarray, "S N 3"]]:
    """What R_fine starts from in every sample, metres; for fitted drapes as predicted without the garment's design.

    Args:
        model: Its configuration and template.
        kriging: The fitted process.
        left_out: From `KrigingFit.without_each_design`.
        samples: Those that were fitted.
        manifest: Splits of designs and topologies.
        fabric: Whose drapes.
    """
    predictor, reader, found = Predictor(model.config, "smooth"), NodeReader(model), []
    for s in tqdm(samples, desc="kriged drapes", mininterval=2):
        starts = predictor(kriging, s.garment, s.betas)
        if s.name in left_out:
            count, operator = s.garment.num_vertices, reader.operator(s.garment)
            base = np.asarray(_base_and_detail(model.config, s.garment)[0])[None, :count]
            moved = np.stack([operator @ field for field in left_out[s.name]])
            starts[rows_of(s, manifest, fabric), :count] = base + moved
        found.append(starts)
    return found


def kriging_error(
    model: TryOnModel, kriging: Kriging, samples: Sequence[SimulatedGarment], manifest: Manifest, fabric: str
) -> float:
    """Mean distance of kriged drapes from the simulation over validation samples, mm; see `validation_error`.

    Args:
        model: Its configuration.
        kriging: The process.
        samples: Garments with their drapes.
        manifest: Splits of designs and topologies.
        fabric: Whose drapes.
    """
    sets = []
    for drapes in fine_sets(samples, manifest, fabric):
        detail = fine_base(model.config, _base_and_detail(model.config, drapes.garment)[1])
        sets.append(replace(drapes, inputs=None, targets=drapes.targets - np.asarray(detail)[None]))
    return validation_error(Predictor(model.config, "smooth"), kriging, sets)
