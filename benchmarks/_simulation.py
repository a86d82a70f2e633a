"""What `python -m benchmarks compare` measures of contact and cloth: collision loss, solver step, full equilibrium."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from benchmarks._garments import garment_of, mesh_of_size, model_of
from benchmarks._subjects import FRESH, Cell, Work
from tryon_jax.body import load_body, shape_body, vertex_normals
from tryon_jax.contact.collision_loss import VertexNeighbours, collision_loss, list_neighbours
from tryon_jax.contact.push_out import PushedOut, push_out
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.physics.batch import sweep_many
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, dress, follow
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.physics.solver import step
from tryon_jax.physics.state import ClothState, SolverSettings

FABRIC = "gray-interlock"
MARGIN = 2e-3
WALK = 4
"""Moves in search of the closest body vertex, as in training."""
LIST_LENGTH = 33
"""Candidates of one move."""
CG_ITERATIONS = 30
"""Assumed for the predictions of time alone; what was taken is recorded."""


@cache
def _neighbours() -> VertexNeighbours:
    return list_neighbours(load_body())


def collision(cell: Cell) -> Work:
    """L_collision of garments on bodies, value and gradient by the garment's vertices; the bodies are shaped too."""
    body, garment = load_body(), garment_of(model_of(None).config, cell.vertices)
    mask, nearest = jnp.asarray(garment.graph.mask), jnp.asarray(garment.graph.body_vertices)
    neighbours, faces = _neighbours(), jnp.asarray(body.faces)

    def loss(points: jax.Array, betas: jax.Array) -> jax.Array:
        def one(points: jax.Array, betas: jax.Array) -> jax.Array:
            skin = shape_body(body, betas)[0]
            return collision_loss(points, mask, skin, vertex_normals(skin, faces), neighbours, nearest, MARGIN, WALK)[0]

        return jax.vmap(one)(points, betas).mean()

    rng = np.random.default_rng((cell.vertices, cell.batch))
    rest = np.asarray(garment.graph.vertices)
    inputs = []
    for _ in range(FRESH):
        points = rest[None] + 3e-3 * rng.normal(size=(cell.batch, *rest.shape))
        betas = rng.uniform(-1.4, 1.4, (cell.batch, 2))
        inputs.append((jnp.asarray(points, jnp.float32), jnp.asarray(betas, jnp.float32)))

    def check(run: Callable[..., Any]) -> float:
        points, betas = inputs[0]
        value, gradient = run(points, betas)
        total, slope = 0.0, np.zeros(points.shape)
        real = np.asarray(mask)
        for b in range(cell.batch):
            skin = np.asarray(shape_body(body, betas[b])[0])
            normals = np.asarray(vertex_normals(jnp.asarray(skin), faces), np.float64)
            at = np.asarray(points[b], np.float64)[real]
            closest = cKDTree(skin).query(at)[1]
            depth = MARGIN - (normals[closest] * (at - skin[closest])).sum(1)
            total += np.maximum(depth, 0.0).mean() / cell.batch
            slope[b, real] = np.where(depth[:, None] > 0, -normals[closest], 0.0) / (real.sum() * cell.batch)
        # At equal distances the search may end at another vertex: a few in a thousand may differ.
        different = np.linalg.norm(np.asarray(gradient) - slope, axis=2) > 0.05 / (real.sum() * cell.batch)
        return max(abs(float(value) / total - 1), different[:, real].mean() / 5)

    visits = float(cell.batch * len(rest) * WALK * LIST_LENGTH)
    moved = 4.0 * cell.batch * len(rest) * 3 * 2
    return Work(jax.value_and_grad(loss), (), inputs, check, 5e-3, "relative", cell.batch, 9.0 * visits, moved)


@cache
def _cloth(vertices: int) -> Cloth:
    mesh = mesh_of_size(vertices)
    return build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, len(mesh.start))


@cache
def _obstacle() -> Obstacle:
    return Obstacle(load_body())


@cache
def _dressed(vertices: int) -> Drape:
    mesh = mesh_of_size(vertices)
    quick = Equilibrium(max_steps=60)
    return dress(mesh.start, _cloth(vertices), load_fabric(FABRIC), _obstacle(), SolverSettings(), quick, max_steps=60)


def _matrix_bytes(cloth: Cloth) -> float:
    """The block matrix once, with its columns and four vectors."""
    return float(_num_blocks(cloth) * 40 + 8 * len(cloth.vertex_areas) * 12)


def _num_blocks(cloth: Cloth) -> int:
    """Blocks of the system matrix, empty ones included."""
    beside, rows = cloth.incidence.neighbours.shape
    return rows * (beside + 1)


def solver_step(cell: Cell) -> Work:
    """One implicit step on the mean body, for several states of one garment."""
    cloth, fabric, drape = _cloth(cell.vertices), load_fabric(FABRIC), _dressed(cell.vertices)
    surface, settings = drape.surface, SolverSettings()
    still = jnp.zeros_like(surface.vertices)

    def run(x: jax.Array, state: ClothState, cloth: Cloth, surface: Any) -> tuple[Any, ...]:
        def one(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            new, report = step(replace(state, x=x), cloth, fabric, surface, settings, still)
            return new.x, report.residual, report.iterations

        return jax.vmap(one)(x)

    rng = np.random.default_rng((cell.vertices, cell.batch))
    shape = (cell.batch, *drape.state.x.shape)
    inputs = [
        (jnp.asarray(np.asarray(drape.state.x)[None] + 2e-4 * rng.normal(size=shape), jnp.float32),)
        for _ in range(FRESH)
    ]
    fixed = (drape.state, cloth, surface)

    def call(x: jax.Array, state: ClothState, cloth: Cloth, surface: Any) -> tuple[Any, ...]:
        return run(x, state, cloth, surface)

    def check(made: Callable[..., Any]) -> float:
        found, residual, _ = made(*fixed, *inputs[0])
        with jax.enable_x64(True):
            wide = jax.tree.map(_widened, (inputs[0][0][:1], *fixed))
            exact, exact_residual, _ = jax.jit(call)(*wide)
            error = abs(float(residual[0]) / float(exact_residual[0]) - 1)
            apart = float(jnp.abs(exact[0] - found[0]).max())
        # The linear solver stops at a tenth: moves differ by rounding at its last iteration.
        return max(error, apart / 1e-3 * 1e-2)

    moved = cell.batch * CG_ITERATIONS * _matrix_bytes(cloth)
    flops = cell.batch * CG_ITERATIONS * 18.0 * _num_blocks(cloth)
    return Work(
        lambda state, cloth, surface, x: run(x, state, cloth, surface),
        fixed, inputs, check, 1e-2, "relative", cell.batch, flops, moved,
    )  # fmt: skip


def _widened(leaf: Any) -> Any:
    array = np.asarray(leaf)
    return jnp.asarray(array.astype(np.float64) if array.dtype == np.float32 else array)


@cache
def _at_rest(vertices: int) -> Drape:
    """The garment on the mean body, at rest."""
    mesh = mesh_of_size(vertices)
    return dress(mesh.start, _cloth(vertices), load_fabric(FABRIC), _obstacle(), SolverSettings(), Equilibrium())


class FullEquilibrium:
    """From one body shape to the next, to rest: the unit of work of the dataset. Runs on the host around the solver."""

    def __init__(self, cell: Cell) -> None:
        self.cloth, self.fabric, self.obstacle = _cloth(cell.vertices), load_fabric(FABRIC), _obstacle()
        self.settings, self.equilibrium = SolverSettings(), Equilibrium()
        self.start = _at_rest(cell.vertices)
        self.moved = CG_ITERATIONS * 30 * _matrix_bytes(self.cloth)
        self.flops = CG_ITERATIONS * 30 * 18.0 * _num_blocks(self.cloth)

    def __call__(self, number: int) -> Drape:
        """Follow the body to one of three shapes, an eighth of a ray away."""
        angle = 2 * np.pi * number / FRESH
        betas = 0.125 * np.array([3 * np.cos(angle), 2 * np.sin(angle)])
        return follow(self.start, betas, self.cloth, self.fabric, self.obstacle, self.settings, self.equilibrium)

    def check(self, drape: Drape) -> float:
        """The force that is left, over its tolerance, computed again in float64."""
        still = jnp.zeros_like(drape.surface.vertices)
        with jax.enable_x64(True):
            wide = jax.tree.map(_widened, (drape.state, self.cloth, drape.surface, still))

            def residual(state: Any, cloth: Any, surface: Any, still: Any) -> jax.Array:
                return step(state, cloth, self.fabric, surface, self.settings, still)[1].residual

            return float(jax.jit(residual)(*wide)) / self.equilibrium.tolerance


class SideBySide(FullEquilibrium):
    """The same for many bodies in lanes of one mapped solve."""

    def __init__(self, cell: Cell) -> None:
        super().__init__(cell)
        self.lanes = cell.batch

    def drapes(self, number: int, most: int | None = None) -> list[Drape]:
        """Follow the bodies to as many shapes, an eighth of a ray away in all directions, in at most `most` steps."""
        angles = 2 * np.pi * (np.arange(self.lanes) + number / FRESH) / self.lanes
        betas = 0.125 * np.stack([3 * np.cos(angles), 2 * np.sin(angles)], axis=1)
        equilibrium = self.equilibrium if most is None else replace(self.equilibrium, max_steps=most)
        many = [self.start] * self.lanes, betas[:, None], [self.cloth] * self.lanes, [self.fabric] * self.lanes
        [found] = sweep_many(*many, self.obstacle, self.settings, equilibrium)
        return found


class PushOut:
    """A drape brought out of a body by the smallest displacement; runs on the host."""

    def __init__(self, cell: Cell) -> None:
        body, mesh = load_body(), mesh_of_size(cell.vertices)
        self.faces, self.start = mesh.faces, np.asarray(mesh.mean, np.float64)
        angles = 2 * np.pi * np.arange(FRESH) / FRESH
        betas = np.stack([1.5 * np.cos(angles), np.sin(angles)], axis=1)
        self.bodies = [
            ClosedSurface(np.asarray(shape_body(body, jnp.asarray(b))[0]), np.asarray(body.faces)) for b in betas
        ]

    def __call__(self, number: int) -> PushedOut:
        """The mean drape out of one of three bodies."""
        return push_out(self.start, self.faces, self.bodies[number % FRESH])
