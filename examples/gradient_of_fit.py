"""What to change in the pattern for a looser fit: the gradient of a garment's clearance with respect to its design.

python examples/gradient_of_fit.py
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

import tryon_jax as tj


def main(design: str = "dress", betas: tuple[float, ...] = (0.5, -1.0)) -> dict[str, float]:
    """The change of the mean clearance, millimetres, for one centimetre more of each design parameter."""
    model = tj.load_pretrained()
    garment = tj.prepare(model, design)
    shape = jnp.asarray(betas)
    body, _ = tj.shape_body(model.body, shape)
    normals = tj.vertex_normals(body, model.body.faces)
    # Which point of the body is closest changes slowly: it is looked up once and kept.
    draped = garment.unpad(tj.drape(model, garment, shape))
    nearest = cKDTree(np.asarray(body)).query(draped)[1]

    @jax.jit
    @jax.grad
    def slope(parameters):
        vertices = tj.drape(model, garment, shape, design=parameters)[: garment.num_vertices]
        clearance = jnp.sum((vertices - body[nearest]) * normals[nearest], axis=1)
        return jnp.mean(clearance)

    gradient = np.asarray(slope(jnp.asarray(garment.design)))
    names = tj.load_design_space().names
    effect = {name: float(10 * value) for name, value in zip(names, gradient, strict=True)}
    for name, millimetres in effect.items():
        print(f"1 cm more of {name:<14} changes the mean clearance by {millimetres:+.2f} mm")
    return effect


if __name__ == "__main__":
    main()
