"""Which pattern and which body made this drape? Design and betas are recovered from vertices by Levenberg-Marquardt.

python examples/recover_design.py
"""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

import tryon_jax as tj


def main() -> tuple[np.ndarray, np.ndarray]:
    """Recover parameters from a drape that the model made itself; returns true and found ones."""
    model = tj.load_pretrained()
    space = tj.load_design_space()
    garment = tj.prepare(model, space.mean_design)
    count = garment.num_vertices
    # Every unknown counts in its own unit: half its range for the design, one standard deviation for the body.
    scale = jnp.asarray(np.r_[0.5 * (space.maximum - space.minimum), np.ones(model.config.num_betas)], jnp.float32)
    origin = jnp.asarray(np.r_[space.mean, np.zeros(model.config.num_betas)], jnp.float32)

    def drape(unknowns):
        values = origin + scale * unknowns
        design, betas = values[: len(space.names)], values[len(space.names) :]
        return tj.drape(model, garment, betas, design=design)[:count]

    truth = jnp.array([0.4, -0.3, 0.5, 1.2, -0.8])
    target = jax.jit(drape)(truth)
    # A tenth of the vertices is plenty for five unknowns.
    some = jnp.arange(0, count, 10)
    solver = optx.LevenbergMarquardt(rtol=1e-5, atol=1e-5)
    found = optx.least_squares(
        lambda unknowns, _: 1e3 * (drape(unknowns)[some] - target[some]),
        solver,
        jnp.zeros(5),
        max_steps=30,
        throw=False,
    ).value
    error = 1e3 * float(jnp.linalg.norm(jax.jit(drape)(found) - target, axis=1).mean())
    names = [*space.names, *(f"beta {i + 1}" for i in range(model.config.num_betas))]
    for name, real, guess in zip(names, origin + scale * truth, origin + scale * found, strict=True):
        print(f"{name:<14} true {float(real):+.3f}   found {float(guess):+.3f}")
    print(f"drapes differ by {error:.2f} mm on average")
    return np.asarray(truth), np.asarray(found)


if __name__ == "__main__":
    main()
