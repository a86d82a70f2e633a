"""Training R_mean: from design parameters to the template's drape on the mean body (section 4.1 of the paper)."""

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float

from tryon_jax.garment.manifest import Manifest
from tryon_jax.nets.mlp import MeanDrape, apply_mean_drape, init_mean_drape
from tryon_jax.training.dataset import is_good, load_arrays

_SMALLEST_SCALE = 1e-3
# A single design has no standard deviation from which to take the unit of the output.


@dataclass(frozen=True)
class MeanTraining:
    """Options of R_mean's training."""

    hidden: int = 48
    """Neurons of the hidden layer. The paper has ten; with them the error on held-out designs is 1.8 times as large."""
    steps: int = 6000
    """Full-batch steps; the weights with the smallest validation error are kept."""
    learning_rate: float = 0.01
    weight_decay: float = 3e-7
    seed: int = 0


@dataclass(frozen=True, eq=False)
class TemplateSamples:
    """Designs and their drapes."""

    designs: Float[np.ndarray, "N P"]
    """Parameters, metres."""
    templates: Float[np.ndarray, "N T 3"]
    """Template vertices, metres."""
    held: Bool[np.ndarray, " N"]
    """Designs that only choose the weights."""

    def part(self, rows: Bool[np.ndarray, " N"]) -> "TemplateSamples":
        """Some of the samples."""
        return TemplateSamples(self.designs[rows], self.templates[rows], self.held[rows])


def load_templates(root: Path, manifest: Manifest) -> TemplateSamples:
    """All good template drapes of a dataset; the manifest's validation designs are held out.

    Without a validation design among them, every sixth is.

    Raises:
        FileNotFoundError: there is none.
    """
    tables = {path.stem: load_arrays(path) for path in sorted((root / "templates").glob("[!.]*.npz"))}
    kept = {label: table for label, table in tables.items() if bool(is_good(table))}
    if not kept:
        raise FileNotFoundError(f"no template drapes in {str(root)!r}: run `python -m experiments simulate` first")
    held = np.isin(list(kept), manifest.validation)
    if not held.any():
        held = np.arange(len(kept)) % 6 == 5
    designs, templates = (np.stack([table[key] for table in kept.values()]) for key in ("design", "template"))
    return TemplateSamples(designs, templates, held)


def mean_error(net: MeanDrape, samples: TemplateSamples) -> float:
    """Mean distance of template vertices from their simulated place, metres."""
    predicted = jax.vmap(apply_mean_drape, (None, 0))(net, jnp.asarray(samples.designs, jnp.float32))
    return float(np.linalg.norm(np.asarray(predicted) - samples.templates, axis=-1).mean())


def train_mean(
    samples: TemplateSamples,
    center: Float[np.ndarray, " P"],
    scale: Float[np.ndarray, " P"],
    options: MeanTraining,
) -> tuple[MeanDrape, list[dict[str, float]]]:
    """Fit R_mean by least squares with weight regularisation.

    Args:
        samples: training drapes.
        center: design parameters are normalised as (p − center) / scale; metres.
        scale: see `center`; metres.
        options: steps, weight regularisation and seed.

    Returns:
        the network and its curve (step, training loss, validation error in millimetres).
    """
    train = samples.part(~samples.held)
    validation = samples.part(samples.held) if samples.held.any() else train
    template_center = train.templates.mean(axis=0)
    net = init_mean_drape(
        jax.random.key(options.seed),
        jnp.asarray(center, jnp.float32),
        jnp.asarray(scale, jnp.float32),
        jnp.asarray(template_center, jnp.float32),
        max(float((train.templates - template_center).std()), _SMALLEST_SCALE),
        options.hidden,
    )
    optimiser = optax.adam(optax.cosine_decay_schedule(options.learning_rate, options.steps))
    designs, templates = jnp.asarray(train.designs, jnp.float32), jnp.asarray(train.templates, jnp.float32)

    def loss(mlp, net: MeanDrape) -> Float[Array, ""]:
        current = MeanDrape(mlp, net.design_center, net.design_scale, net.template_center, net.template_scale)
        error = (jax.vmap(apply_mean_drape, (None, 0))(current, designs) - templates) / net.template_scale
        return (error * error).mean() + options.weight_decay * sum((w * w).sum() for w in mlp.weights)

    @jax.jit
    def many(mlp, state, net):
        def one(_, carry):
            mlp, state, _ = carry
            value, gradient = jax.value_and_grad(loss)(mlp, net)
            updates, state = optimiser.update(gradient, state)
            return optax.apply_updates(mlp, updates), state, value

        return jax.lax.fori_loop(0, 100, one, (mlp, state, jnp.zeros(())))

    mlp, state = net.mlp, optimiser.init(net.mlp)
    best, best_error, curve = net, np.inf, []
    for done in range(100, options.steps + 1, 100):
        mlp, state, value = many(mlp, state, net)
        current = MeanDrape(mlp, net.design_center, net.design_scale, net.template_center, net.template_scale)
        error = mean_error(current, validation)
        curve.append({"step": done, "loss": float(value), "validation_mm": 1e3 * error})
        if error < best_error:
            best, best_error = current, error
    return best, curve
