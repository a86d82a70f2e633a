"""One garment on many bodies at once: `jax.vmap` over body shapes, compiled once.

python examples/many_bodies.py
"""

import time

import jax
import numpy as np

import tryon_jax as tj


def main(count: int = 32) -> np.ndarray:
    """Drape a T-shirt on `count` random bodies and return the vertices [count, V, 3]."""
    model = tj.load_pretrained()
    garment = tj.prepare(model, "tshirt")
    betas = np.random.default_rng(0).uniform(-2, 2, (count, model.config.num_betas)).astype(np.float32)

    drape_all = jax.jit(jax.vmap(tj.drape, in_axes=(None, None, 0)))
    jax.block_until_ready(drape_all(model, garment, betas))
    start = time.perf_counter()
    vertices = garment.unpad(jax.block_until_ready(drape_all(model, garment, betas)))
    seconds = time.perf_counter() - start
    print(f"{count} drapes of {garment.num_vertices} vertices in {seconds:.2f} s")

    width = np.ptp(vertices[:, :, 0], axis=1)
    tallest = betas[:, 0].argmax()
    print(f"cuff to cuff {width.min():.2f} to {width.max():.2f} m; on the tallest body {width[tallest]:.2f} m")
    return vertices


if __name__ == "__main__":
    main()
