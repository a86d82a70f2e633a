"""Coefficients of drape fields from the simulated drapes, by principal components over body shapes.

The drapes of all garments lie close to the span of the same few functions of the betas. These are the principal
components of the training drapes, known at the simulated shapes and interpolated to all others by a thin plate. A
perceptron learns them once, before the networks are trained, and stays as it is. Trained together with the fields, it
fitted the simulated shapes and was off between them (docs/training.md, *Coefficients*).
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float
from scipy.interpolate import RBFInterpolator

from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.mlp import MLP
from tryon_jax.training.collisions import random_betas
from tryon_jax.training.stage_sets import StageSet, displacements
from tryon_jax.training.thin_plate import thin_plate
from tryon_jax.tryon import Stage
from tryon_jax.tryon.stages import field_coefficients

EVERY = 4
"""One vertex of so many tells enough about a drape."""
SAMPLES = 4000
"""Random body shapes at which the perceptron learns the thin plate."""
STEPS = 6000
LEARNING_RATE = 1e-2
SWEEPS = 15
"""Rounds in which missing drapes are filled in from the components."""
COMMON = 0.8
"""Garments with at least this share of the most drapes that any has tell the components; others have too few."""
MARGIN = 1.05
"""The plate is learned on an ellipse of betas that is larger by this factor."""


def principal_coefficients(config: TryOnConfig, stage: Stage, sets: Sequence[StageSet], seed: int) -> MLP:
    """The perceptron from betas to coefficients that suits the training drapes of `sets`.

    Args:
        config: Of the model.
        stage: The stage before training, whose perceptron gives the sizes and the start.
        sets: What the stage is trained on.
        seed: Of the random body shapes.

    Returns:
        The perceptron; coefficient k has the root mean square σ_k / σ_1 times a common factor, so that all fields are
        of one size.

    Raises:
        ValueError: the stage takes the betas at its nodes.
    """
    if stage.coefficients is None:
        raise ValueError('principal coefficients need conditioning="fields"')
    betas, drapes, known = _common_drapes(config, sets)
    values = principal_functions(drapes, known, config.fields)
    extent = np.array(config.beta_ranges)
    wanted = _random_codes(config, seed)
    if config.stance:
        betas, values = with_t_pose(betas, values)
    return _fit(stage.coefficients, wanted, spread_over_shapes(betas / extent, values, wanted / extent), config)


def with_t_pose(
    codes: Float[np.ndarray, "S b"], values: Float[np.ndarray, "S K"]
) -> tuple[Float[np.ndarray, "R b"], Float[np.ndarray, "R K"]]:
    """Known values and, for each body shape among them, the T-pose, where nothing changes.

    Args:
        codes: Betas and stance.
        values: There.
    """
    bodies = np.unique(codes[:, :-1], axis=0)
    still = np.concatenate([bodies, np.zeros((len(bodies), 1))], axis=1)
    return np.concatenate([codes, still]), np.concatenate([values, np.zeros((len(still), values.shape[1]))])


def _random_codes(config: TryOnConfig, seed: int) -> Float[np.ndarray, "N b"]:
    """Random body shapes, each in a random stance where there are stances."""
    rng = np.random.default_rng(seed)
    extent = tuple(MARGIN * e for e in config.beta_ranges)
    if not config.stance:
        return random_betas(rng, SAMPLES, extent)
    shapes = random_betas(rng, SAMPLES, extent[:-1])
    return np.concatenate([shapes, rng.uniform(0.0, extent[-1], (SAMPLES, 1)).astype(np.float32)], axis=1)


def spread_over_shapes(
    known: Float[np.ndarray, "S b"], values: Float[np.ndarray, "S K"], wanted: Float[np.ndarray, "N b"]
) -> Float[np.ndarray, "N K"]:
    """Interpolation by a thin plate; by cones where the known shapes are too few for one or lie on a line.

    Args:
        known: Shapes, in half axes of what is covered.
        values: K values at each.
        wanted: Other shapes.
    """
    found = thin_plate(known, values, wanted)
    return RBFInterpolator(known, values, kernel="linear", degree=0)(wanted) if found is None else found


def principal_functions(
    drapes: Float[np.ndarray, "S D"], known: Bool[np.ndarray, "S D"], count: int
) -> Float[np.ndarray, "S K"]:
    """The `count` principal functions of S body shapes, from drapes of which some are missing.

    Args:
        drapes: One row per shape: the displacements of all garments, metres.
        known: Which of them are there; the others are filled in from the components, again and again.
        count: Functions K; those beyond the number of shapes are zero.

    Returns:
        Function k has the root mean square σ_k / √(Σσ² / K) over the shapes.
    """
    filled = np.where(known, drapes, 0.0)
    complete = bool(known.all())
    rank = min(count, len(drapes))
    for sweep in range(1 if complete else SWEEPS):
        left, sizes, right = np.linalg.svd(filled, full_matrices=False)
        if complete or sweep == SWEEPS - 1:
            break
        filled = np.where(known, drapes, (left[:, :rank] * sizes[:rank]) @ right[:rank])
    values = np.zeros((len(drapes), count))
    values[:, :rank] = left[:, :rank] * sizes[:rank]
    return values / np.sqrt((values**2).mean())


def _common_drapes(
    config: TryOnConfig, sets: Sequence[StageSet]
) -> tuple[Float[np.ndarray, "S b"], Float[np.ndarray, "S D"], Bool[np.ndarray, "S D"]]:
    """Displacements of the garments with the most drapes, at the body shapes that half of them have."""
    counts = [int(s.train.sum()) for s in sets]
    chosen = [s for s, count in zip(sets, counts, strict=True) if count >= COMMON * max(counts)]
    shapes: dict[tuple[float, ...], int] = {}
    for s in chosen:
        for row in s.betas[s.train]:
            shapes[tuple(row)] = shapes.get(tuple(row), 0) + 1
    common = sorted(shape for shape, count in shapes.items() if 2 * count >= len(chosen))
    place = {shape: k for k, shape in enumerate(common)}
    columns, found = [], []
    for s in chosen:
        rows = [row for row in np.flatnonzero(s.train) if tuple(s.betas[row]) in place]
        at = [place[tuple(s.betas[row])] for row in rows]
        vertices = np.flatnonzero(np.asarray(s.garment.graph.mask))[::EVERY]
        moved = displacements(config, s, np.array(rows))[:, vertices] / np.sqrt(len(vertices))
        column = np.zeros((len(common), 3 * len(vertices)), np.float32)
        column[at] = moved.reshape(len(rows), -1)
        known = np.zeros(column.shape, bool)
        known[at] = True
        columns.append(column)
        found.append(known)
    return np.array(common), np.concatenate(columns, axis=1), np.concatenate(found, axis=1)


def _fit(start: MLP, betas: Float[np.ndarray, "N b"], values: Float[np.ndarray, "N K"], config: TryOnConfig) -> MLP:
    """The perceptron that gives `values` at `betas`, by full-batch Adam."""
    given, wanted = jnp.asarray(betas, jnp.float32), jnp.asarray(values, jnp.float32)
    optimiser = optax.adam(optax.cosine_decay_schedule(LEARNING_RATE, STEPS))

    def loss(mlp: MLP) -> Array:
        return ((field_coefficients(mlp, given, config.beta_scale, config.beta_periods) - wanted) ** 2).mean()

    @jax.jit
    def run(mlp: MLP) -> MLP:
        def step(_: Array, carried: tuple[MLP, Any]) -> tuple[MLP, Any]:
            mlp, state = carried
            updates, state = optimiser.update(jax.grad(loss)(mlp), state, mlp)
            return optax.apply_updates(mlp, updates), state

        return jax.lax.fori_loop(0, STEPS, step, (mlp, optimiser.init(mlp)))[0]

    return jax.tree.map(np.asarray, run(jax.tree.map(jnp.asarray, start)))
