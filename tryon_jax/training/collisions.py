"""Self-supervised fine-tuning of R_fine: random bodies, designs and topologies, no simulation (section 4.4).

The paper minimises the collision loss alone. That also rewards inflating the garment, so an anchor holds the
predictions to those of the starting weights where nothing collides; `anchor=0` is the paper's pure loss. `replay` goes
further where a dataset is at hand: some of the steps repeat what R_fine has learned from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import cKDTree
from scipy.stats import qmc
from tqdm import tqdm

from tryon_jax.body import shape_body, vertex_normals
from tryon_jax.contact.collision_loss import collision_loss, list_neighbours
from tryon_jax.garment import Design, remesh
from tryon_jax.mesh.quality import edge_lengths
from tryon_jax.training.batches import StageBatch, stacked_numbers
from tryon_jax.training.garments import training_bucket
from tryon_jax.training.loop import LoopOptions
from tryon_jax.training.stage_loss import Distance, StageWeights, map_garments, stage_loss
from tryon_jax.tryon import (
    Garment,
    Stage,
    TryOnModel,
    array_shapes,
    config_space,
    fine_stage,
    of_fabric,
    prepare_mesh,
    smooth_stage,
    stack_garments,
)
from tryon_jax.types import ArrayLike, pytree

WALK_STEPS = 4
"""Moves over the body in search of the closest vertex, from the closest one on the mean body."""


@dataclass(frozen=True)
class CollisionOptions:
    """Options of the collision step."""

    loop: LoopOptions = field(
        default_factory=lambda: LoopOptions(steps=2000, learning_rate=2e-4, evaluate_every=500, weight_decay=0.0)
    )
    pool: int = 96
    """Garments of random design and topology that are trained on."""
    held_out: int = 8
    """Garments of other random designs and topologies that choose the weights."""
    garments: int = 1
    """Garments in a batch."""
    shapes: int = 16
    """Random body shapes of each."""
    weight: float = 100.0
    """Of the collision loss in units of the margin, against the other terms: it is a mean over all vertices, of which a
    percent or two collide."""
    margin: float = 2e-3
    """Clearance asked for, metres."""
    anchor: float = 0.3
    """Weight of the squared change of the prediction (in units of the margin) against the collision loss."""
    replay: float = 0.5
    """Share of the steps that see simulated drapes in place of random ones (needs a dataset; the paper has none): so
    that R_fine keeps what it has learned from them. Their loss is the distance, in units of the margin."""
    stretch: float = 2e5
    """Weight of edges that are stretched beyond `most_stretch` (see `excess_stretch`), which tear on bodies and designs
    that were not simulated; 0 leaves them out, as the paper does."""
    most_stretch: float = 1.25
    """Length over rest length in the pattern that costs nothing."""
    distance: Distance = "plain"
    """Distance of the replayed drapes: plain or squared, best as R_fine was trained (see `displacement_error`)."""


@pytree
class PooledGarment:
    """A prepared garment and the closest vertex of the mean body to each of its vertices."""

    garment: Garment
    nearest: Int[ArrayLike, "*batch N"]
    rest: Float[ArrayLike, "*batch F 3"]
    """Lengths of each face's edges 0→1, 1→2 and 2→0 in the flat pattern, metres; 1 for padding."""


@pytree
class CollisionBatch:
    """G garments of one bucket, B random shapes each."""

    BY_SHAPE = ("betas",)  # axis 1 is B: what `parallel` splits over devices

    pooled: PooledGarment
    betas: Float[ArrayLike, "G B b"]
    numbers: Float[ArrayLike, "G F"] | None = None
    """Of each garment's fabric, for an R_fine of all fabrics."""


def random_betas(rng: np.random.Generator, count: int, extent: tuple[float, ...]) -> Float[np.ndarray, "N b"]:
    """Shapes spread evenly over the ellipse with the half axes `extent` (over the interval for one beta).

    Args:
        rng: Source of random numbers.
        count: Number of shapes.
        extent: Half axes, standard deviations.
    """
    direction = rng.normal(size=(count, len(extent)))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = rng.random((count, 1)) ** (1 / len(extent))
    return (direction * radius * np.array(extent)[None]).astype(np.float32)


def random_fabric(stage: Stage, rng: np.random.Generator) -> Float[np.ndarray, " F"] | None:
    """Numbers between those of two random trained fabrics; None for the R_fine of one fabric.

    Args:
        stage: R_fine.
        rng: Source of random numbers.
    """
    if stage.fabrics is None:
        return None
    known = np.asarray(stage.fabrics.known)
    one, other = known[rng.integers(len(known), size=2)]
    return one + np.float32(rng.random()) * (other - one)


def make_pool(model: TryOnModel, count: int, seed: int) -> list[PooledGarment]:
    """Garments of random designs, each with its own random topology.

    Args:
        model: Its configuration and R_mean.
        count: Number of garments.
        seed: Of designs and topologies.
    """
    space = config_space(model.config)
    tree = cKDTree(np.asarray(model.body.v_template))
    size = 1 << max(1, int(np.ceil(np.log2(count))))
    unit = qmc.Sobol(len(space.names), seed=seed).random(size)[:count]
    pool = []
    for k, row in enumerate(tqdm(unit, desc="garments", mininterval=2)):
        values = space.minimum + row * (space.maximum - space.minimum)
        pool.append(pool_garment(model, space.from_values(values), 1000 * (seed + 1) + k, tree))
    return pool


def pool_garment(model: TryOnModel, design: Design, topology: int, tree: cKDTree) -> PooledGarment:
    """One garment of a pool; `tree` holds the mean body's vertices.

    Args:
        model: Its configuration and R_mean.
        design: The design.
        topology: Seed of the mesh.
        tree: Vertices of the mean body.
    """
    mesh = remesh(config_space(model.config), design, model.config.target_area, seed=topology)
    garment = prepare_mesh(model, mesh, bucket=training_bucket(mesh.num_vertices))
    nearest = tree.query(np.asarray(garment.graph.vertices))[1].astype(np.int32)
    rest = np.ones(garment.graph.faces.shape, np.float32)
    rest[: len(mesh.faces)] = edge_lengths(mesh.uv, mesh.faces_uv)
    return PooledGarment(garment, nearest, rest)


def excess_stretch(
    vertices: Float[Array, "B N 3"], faces: Int[ArrayLike, "F 3"], rest: Float[ArrayLike, "F 3"], limit: float
) -> Float[Array, ""]:
    """Mean over edges and bodies of the square by which length over rest length exceeds `limit`.

    Args:
        vertices: Drapes, metres.
        faces: Triangles.
        rest: Lengths of their edges at rest, metres.
        limit: Stretch that costs nothing.
    """
    corners = vertices[:, jnp.asarray(faces)]
    along = jnp.roll(corners, -1, axis=2) - corners
    length = jnp.sqrt((along * along).sum(-1) + 1e-12)
    beyond = jnp.maximum(length / jnp.asarray(rest)[None] - limit, 0.0)
    return (beyond * beyond).mean()


class CollisionTask:
    """The loss and the measure of one fabric's collision step, for one model."""

    def __init__(self, model: TryOnModel, fabric: str, options: CollisionOptions) -> None:
        """Train the R_fine of one fabric.

        Args:
            model: The model, with the R_fine to be trained.
            fabric: Whose R_fine.
            options: Of the training.
        """
        self.model, self.fabric, self.options = model, fabric, options
        self.start = model.fine[fabric]
        self.first = model.kriging.get(fabric, model.smooth)
        self.neighbours = list_neighbours(model.body)
        self._count = jax.jit(lambda *arguments: self._inside(*arguments))

    def body(self, betas: Float[Array, " b"]) -> tuple[Float[Array, "W 3"], Float[Array, "W 3"]]:
        """Vertices and normals of the body."""
        vertices = shape_body(self.model.body, betas)[0]
        return vertices, vertex_normals(vertices, self.model.body.faces)

    def loss(self, weights: StageWeights, batch: CollisionBatch | StageBatch) -> Float[Array, ""]:
        """Collision loss over the margin, plus the anchor; of simulated drapes, the distance from them."""
        if isinstance(batch, StageBatch):
            stage, distance = weights.of(self.start), self.options.distance
            units = jnp.asarray(self.start.scale) / self.options.margin
            in_margins = 3 * units * units if distance == "squared" else units
            return in_margins * stage_loss(self.model.config, "fine", stage, batch, distance)
        return map_garments(partial(self._garment_loss, weights), batch.pooled, batch.betas, batch.numbers).mean()

    def _garment_loss(
        self,
        weights: StageWeights,
        pooled: PooledGarment,
        betas: Float[Array, "B b"],
        numbers: Float[Array, " F"] | None,
    ) -> Float[Array, ""]:
        config, options = self.model.config, self.options
        start, stage = of_fabric(self.start, numbers), of_fabric(weights.of(self.start), numbers)
        garment, mask = pooled.garment, jnp.asarray(pooled.garment.graph.mask)
        smooth = smooth_stage(config, self.first, garment, betas)
        fine = fine_stage(config, stage, garment, betas, smooth)
        anchor = jnp.zeros(())
        if options.anchor:
            before = fine_stage(config, start, garment, betas, smooth)
            moved = jnp.where(mask[None, :, None], fine - before, 0.0) / options.margin
            anchor = options.anchor * (moved * moved).sum() / (mask.sum() * len(betas))

        def one(vertices, beta):
            skin, normals = self.body(beta)
            loss, _ = collision_loss(
                vertices, mask, skin, normals, self.neighbours, pooled.nearest, options.margin, WALK_STEPS
            )
            return loss

        collisions = jax.vmap(one)(fine, betas).mean() / options.margin * options.weight
        torn = excess_stretch(fine, garment.graph.faces, pooled.rest, options.most_stretch)
        return collisions + options.stretch * torn + anchor

    def _inside(
        self,
        weights: StageWeights,
        pooled: PooledGarment,
        betas: Float[Array, "B b"],
        numbers: Float[Array, " F"] | None,
    ) -> Float[Array, " B"]:
        config, garment = self.model.config, pooled.garment
        smooth = smooth_stage(config, self.first, garment, betas)
        fine = fine_stage(config, of_fabric(weights.of(self.start), numbers), garment, betas, smooth)
        mask = jnp.asarray(garment.graph.mask)

        def one(vertices, beta):
            skin, normals = self.body(beta)
            _, measured = collision_loss(
                vertices, mask, skin, normals, self.neighbours, pooled.nearest, steps=WALK_STEPS
            )
            return measured["inside"]

        return jax.vmap(one)(fine, betas)

    def inside_share(self, weights: StageWeights, pool: Sequence[PooledGarment], seed: int) -> float:
        """Share of vertices behind their closest body vertex, over a pool and fixed random shapes.

        Args:
            weights: Of R_fine.
            pool: Garments.
            seed: Of the body shapes.

        Returns:
            A share, 0 to 1.
        """
        rng = np.random.default_rng(seed)
        shares = []
        for pooled in pool:
            betas = random_betas(rng, self.options.shapes, self.model.config.beta_ranges)
            numbers = random_fabric(self.start, rng)
            shares.append(np.asarray(self._count(weights, pooled, betas, numbers)).mean())
        return float(np.mean(shares))


def draw_collisions(
    pool: Sequence[PooledGarment],
    options: CollisionOptions,
    extent: tuple[float, ...],
    rng: np.random.Generator,
    stage: Stage | None = None,
) -> CollisionBatch:
    """A batch of garments that share a bucket, with random shapes.

    Args:
        pool: Garments to draw from.
        options: Sizes of the batch.
        extent: Half axes of the body shapes, standard deviations.
        rng: Source of random numbers.
        stage: R_fine; one of all fabrics sees random ones.
    """
    first = pool[int(rng.integers(len(pool)))]
    chosen = [first]
    if options.garments > 1:
        group = [p for p in pool if array_shapes(p.garment) == array_shapes(first.garment)]
        chosen += [group[i] for i in rng.integers(len(group), size=options.garments - 1)]
    betas = np.stack([random_betas(rng, options.shapes, extent) for _ in chosen])
    garments = stack_garments([p.garment for p in chosen])
    pooled = PooledGarment(garments, np.stack([p.nearest for p in chosen]), np.stack([p.rest for p in chosen]))
    fabrics = [None if stage is None else random_fabric(stage, rng) for _ in chosen]
    return CollisionBatch(pooled, betas, stacked_numbers(fabrics))


def with_fine(model: TryOnModel, fabric: str, stage: Stage) -> TryOnModel:
    """The model with another R_fine for one fabric.

    Args:
        model: The model.
        fabric: Whose R_fine.
        stage: The R_fine to put there.
    """
    return replace(model, fine={**model.fine, fabric: stage})
