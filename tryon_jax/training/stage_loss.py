"""The losses of R_smooth and R_fine (sections 4.2 and 4.3 of the paper).

Both minimise the displacement error over the vertices of a batch that mixes designs, topologies and shapes; one set of
weights serves them all.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from tryon_jax.nets.config import TryOnConfig
from tryon_jax.nets.mlp import MLP
from tryon_jax.nets.unet import UNet
from tryon_jax.physics.bending import bending_energy
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.state import GRAVITY
from tryon_jax.physics.stretch import stretch_energy
from tryon_jax.training.batches import StageBatch
from tryon_jax.training.stage_prediction import predict
from tryon_jax.training.surface_loss import edge_error, normal_error
from tryon_jax.tryon import Stage, of_fabric
from tryon_jax.types import pytree

Distance = Literal["squared", "plain"]


ROUNDED = 1e-4
"""Below this the plain distance is rounded off, so that its gradient stays finite; metres."""


@pytree
class StageWeights:
    """What training changes of a stage."""

    net: UNet
    coefficients: MLP | None = None
    """None where they stay as they are, and in the paper's form."""

    def of(self, stage: Stage) -> Stage:
        """The stage with these weights."""
        return replace(stage, net=self.net, coefficients=self.coefficients or stage.coefficients)


def stage_loss(
    config: TryOnConfig,
    kind: str,
    stage: Stage,
    batch: StageBatch,
    distance: Distance = "squared",
    energy: float = 0.0,
    fabric: Fabric | None = None,
    edges: float = 0.0,
    normals: float = 0.0,
) -> Float[Array, ""]:
    """Mean vertex error over the stage's scale (dimensionless), every drape alike.

    Args:
        config: of the model.
        kind: "smooth" or "fine".
        stage: network and scale.
        batch: samples.
        distance: see `displacement_error`.
        energy: weight of the cloth's energy of the prediction, see `relative_energy`.
        fabric: the stage's fabric, where there is such a weight.
        edges: weight of the edges' error, see `edge_error`.
        normals: weight of the normals' error, see `normal_error`.
    """
    predicted = map_garments(
        lambda g, b, i, n: predict(config, kind, of_fabric(stage, n), g, b, i),
        batch.garments,
        batch.betas,
        batch.inputs,
        batch.numbers,
    )
    mask = jnp.asarray(batch.garments.graph.mask)
    scale = jax.lax.stop_gradient(jnp.asarray(stage.scale))
    targets = jnp.asarray(batch.targets)
    loss = displacement_error(predicted, targets, mask, scale, distance)
    faces = jnp.asarray(batch.garments.graph.faces)
    for weight, error in ((edges, edge_error), (normals, normal_error)):
        if weight:
            of_bodies = jax.vmap(error, (0, 0, None))
            loss = loss + weight * jax.vmap(of_bodies)(predicted, targets, faces).mean()
    if energy and fabric is not None and batch.cloth is not None:
        many = jax.vmap(jax.vmap(relative_energy, (0, None, None)), (0, 0, None))
        loss = loss + energy * many(predicted, batch.cloth, fabric).mean()
    return loss


def displacement_error(
    predicted: Float[Array, "G B N 3"],
    targets: Float[Array, "G B N 3"],
    mask: Bool[Array, "G N"],
    scale: Float[Array, ""],
    distance: Distance,
) -> Float[Array, ""]:
    """Mean error over the scale (dimensionless), over a garment's vertices first, so that every drape counts alike.

    Args:
        predicted: vertices, metres.
        targets: where they should be, metres.
        mask: which are no padding.
        scale: unit of length, metres.
        distance: squared: the mean square of a coordinate's error. plain: the mean distance, the ℓ²-norm of each
            vertex's error, which weights large errors less: where cloth may fold in two ways, the mean of the two,
            which is no fold, has the smallest squared error.
    """
    error = jnp.where(mask[:, None, :, None], predicted - targets, 0.0) / scale
    squares = (error * error).sum(axis=3)
    if distance == "squared":
        of_vertices = squares / 3
    else:
        rounded = ROUNDED / scale
        of_vertices = jnp.sqrt(squares + rounded * rounded) - rounded
    return (of_vertices.sum(axis=2).mean(axis=1) / mask.sum(axis=1)).mean()


def map_garments(function: Callable[..., Array], *batch: Any) -> Array:
    """`jax.vmap` over leading axes; a single garment needs none of what makes several look like one."""
    if jax.tree.leaves(batch)[0].shape[0] > 1:
        return jax.vmap(function)(*batch)
    return function(*jax.tree.map(lambda leaf: leaf[0], batch))[None]


def relative_energy(vertices: Float[Array, "N 3"], cloth: Cloth, fabric: Fabric) -> Float[Array, ""]:
    """Stretch, bending and gravity of a drape over its weight (metres: how high the energy would lift it), times 1/mm.

    The simulator's equilibrium is a minimum of it under contact, where the mean over many equilibria is none.

    Args:
        vertices: The drape, metres.
        cloth: Rest state.
        fabric: Material.
    """
    mass = jnp.asarray(cloth.vertex_areas) * fabric.density
    stored = stretch_energy(vertices, cloth, fabric) + bending_energy(vertices, cloth, fabric)
    lifted = (mass * vertices[:, 1]).sum() * GRAVITY
    return 1e3 * (stored + lifted) / (mass.sum() * GRAVITY)
