"""The drape as a layer: a small network learns to guess the body from how a garment hangs, by the drape's own gradient.

python examples/drape_in_training.py
"""

import jax
import jax.numpy as jnp
import optax

import tryon_jax as tj


def main(steps: int = 60, batch: int = 4) -> tuple[float, float]:
    """Train for `steps`; returns the mean error of reproduced drapes on other bodies before and after, millimetres."""
    model = tj.load_pretrained()
    garment = tj.prepare(model, "tshirt", target_area=1e-3)
    count, num_betas = garment.num_vertices, model.config.num_betas

    def drape(betas):
        return tj.drape(model, garment, betas)[:, :count]

    average = jax.jit(drape)(jnp.zeros((1, num_betas)))

    def guess(weights, vertices):
        seen = 10 * (vertices - average).reshape(len(vertices), -1)
        return jnp.tanh(seen @ weights["first"]) @ weights["second"]

    def loss(weights, betas):
        vertices = drape(betas)
        # Nobody tells the network the betas: it is judged by the drape that its guess makes.
        again = drape(guess(weights, vertices))
        return 1e3 * jnp.sqrt(jnp.mean(jnp.sum((again - vertices) ** 2, axis=-1)))

    first, second, trained, others = jax.random.split(jax.random.key(0), 4)
    weights = {
        "first": 0.02 * jax.random.normal(first, (3 * count, 16)),
        "second": 0.1 * jax.random.normal(second, (16, num_betas)),
    }
    optimiser = optax.adam(optax.cosine_decay_schedule(1e-2, steps))

    @jax.jit
    def step(weights, state, betas):
        value, gradient = jax.value_and_grad(loss)(weights, betas)
        updates, state = optimiser.update(gradient, state)
        return optax.apply_updates(weights, updates), state, value

    state = optimiser.init(weights)
    unseen = jax.random.uniform(others, (16, num_betas), minval=-2, maxval=2)
    error = jax.jit(loss)
    before = float(error(weights, unseen))
    for betas in jax.random.uniform(trained, (steps, batch, num_betas), minval=-2, maxval=2):
        weights, state, _ = step(weights, state, betas)
    after = float(error(weights, unseen))
    print(f"drapes on other bodies reproduced to {before:.1f} mm before, {after:.1f} mm after {steps} steps")
    return before, after


if __name__ == "__main__":
    main()
