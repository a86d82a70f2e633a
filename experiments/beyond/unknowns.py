"""Shared by the inverse problems: unknowns in their own units, drapes at the template's vertices, lengths of a
garment."""

from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.garment import DesignSpace, GarmentMesh
from tryon_jax.training.protocol import EXTENT
from tryon_jax.tryon import Garment
from tryon_jax.types import ArrayLike, Body, pytree

_PULL = 0.02
"""Weight that draws template vertices towards the vertices that lie near them, as in the data for R_mean."""
_WALL = 100.0
"""Millimetres that one unit beyond the range costs."""


@pytree
class Unknowns:
    """Design parameters in half ranges from their middle and betas as they are, in one vector."""

    center: Float[ArrayLike, " U"]
    scale: Float[ArrayLike, " U"]
    limit: Float[ArrayLike, " U"]
    """Largest absolute value of each unknown."""

    @classmethod
    def of(cls, space: DesignSpace, num_betas: int) -> "Unknowns":
        """Unknowns of a design space, with `num_betas` betas (0: the body is known)."""
        middle, half = 0.5 * (space.maximum + space.minimum), 0.5 * (space.maximum - space.minimum)
        extent = np.array(EXTENT[:num_betas])
        return cls(
            np.concatenate([middle, np.zeros(num_betas)]).astype(np.float32),
            np.concatenate([half, np.ones(num_betas)]).astype(np.float32),
            np.concatenate([np.ones(len(half)), extent]).astype(np.float32),
        )

    def values(self, units: Float[ArrayLike, " U"]) -> Float[Array, " U"]:
        """Design in metres, then betas."""
        return jnp.asarray(self.center) + self.scale * jnp.asarray(units)

    def units(self, values: Float[np.ndarray, " U"]) -> Float[np.ndarray, " U"]:
        """The inverse of `values`."""
        return ((values - np.asarray(self.center)) / np.asarray(self.scale)).astype(np.float32)

    def beyond(self, units: Float[Array, " U"]) -> Float[Array, " U"]:
        """Residuals, millimetres, that keep unknowns within their range."""
        return _WALL * jnp.maximum(jnp.abs(units) - self.limit, 0.0)


@dataclass(frozen=True, eq=False)
class Found:
    """Where a solver ended."""

    units: Float[np.ndarray, " U"]
    steps: int
    residual: float
    """Root of the mean square of its residuals, millimetres."""
    rounds: list[float] = field(default_factory=list)


def solve(
    residuals: Callable[..., Float[Array, " R"]], start: Float[np.ndarray, " U"], args: object, most: int
) -> Found:
    """Levenberg-Marquardt on residuals in millimetres; `residuals` must be the same object to compile once."""
    units, steps, size = _solve(residuals, jnp.asarray(start, jnp.float32), args, most)
    return Found(np.asarray(units), int(steps), float(size))


def _minimise(residuals: Callable[..., Array], start: Array, args: object, most: int) -> tuple[Array, Array, Array]:
    solver = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-3)
    solution = optx.least_squares(residuals, solver, start, args=args, max_steps=most, throw=False)
    final = residuals(solution.value, args)
    return solution.value, solution.stats["num_steps"], jnp.sqrt((final * final).mean())


_solve = jax.jit(_minimise, static_argnums=(0, 3))


def template_projection(
    corners: Int[np.ndarray, "V 3"], weights: Float[np.ndarray, "V 3"], size: int
) -> tuple[Float[np.ndarray, "T V"], Float[np.ndarray, " T"]]:
    """The linear map from a drape's vertices to the template whose interpolation is nearest to it, and its weights.

    As R_mean's training data are made, as a matrix: drapes of any two topologies of any designs become comparable
    vertex by vertex. A template vertex that few vertices of the drape see counts less, from 1 down to 0.
    """
    interpolation = np.zeros((len(corners), size))
    np.add.at(interpolation, (np.arange(len(corners))[:, None], corners), weights)
    seen = np.maximum(interpolation.sum(axis=0), 1e-9)
    system = interpolation.T @ interpolation + _PULL * np.eye(size)
    right = interpolation.T + _PULL * interpolation.T / seen[:, None]
    return np.linalg.solve(system, right).astype(np.float32), np.minimum(seen, 1.0).astype(np.float32)


@pytree
class Tape:
    """What a garment's lengths are read from: its torso, its hem, and the plane of the tape."""

    faces: Int[ArrayLike, "F 3"]
    torso: Bool[ArrayLike, " F"]
    """Faces that a tape round the chest may cross; sleeves are none of them."""
    hem: Bool[ArrayLike, " N"]
    """Vertices of the hem."""
    point: Float[ArrayLike, "3"]
    normal: Float[ArrayLike, "3"]
    ground: Float[ArrayLike, ""]
    """Height of the soles, metres."""


def make_tape(garment: Garment, mesh: GarmentMesh, body: Body, place: tuple[np.ndarray, np.ndarray], ground: float):
    """The tape of one garment on one body, padded like the garment.

    Args:
        garment: prepared from `mesh`.
        mesh: has the hem.
        body: whose joints tell sleeves from torso.
        place: point and normal of the plane of the tape, from `tape_place`.
        ground: height of the soles, metres.
    """
    arms = [
        k for k, name in enumerate(body.joint_names) if name.split("_")[-1] in ("shoulder", "elbow", "wrist", "hand")
    ]
    graph = garment.graph
    sleeve = np.asarray(graph.skinning_weights)[:, arms].sum(axis=1) > 0.5
    faces = np.asarray(graph.faces)
    hem = np.zeros(graph.num_nodes, bool)
    hem[np.asarray(mesh.loops["hem"])] = True
    point, normal = (np.asarray(x, np.float32) for x in place)
    torso = faces.any(axis=1) & ~sleeve[faces].any(axis=1)
    return Tape(faces, torso, hem, point, normal, np.asarray(ground, np.float32))


def girth_and_hem(tape: Tape, vertices: Float[Array, "N 3"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Length of the torso's cloth in the plane of the tape, and the hem's mean height over the ground; metres.

    Each face that the plane cuts adds the length of the cut: differentiable wherever no vertex lies in the plane.
    """
    corners = vertices[jnp.asarray(tape.faces)]
    height = jnp.einsum("fkc,c->fk", corners - jnp.asarray(tape.point)[None, None], jnp.asarray(tape.normal))
    following = jnp.roll(corners, -1, axis=1)
    low, high = height, jnp.roll(height, -1, axis=1)
    cut = (low >= 0) != (high >= 0)
    fraction = low / jnp.where(cut, low - high, 1.0)
    points = corners + fraction[..., None] * (following - corners)
    total = jnp.zeros((), vertices.dtype)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        both = cut[:, first] & cut[:, second] & jnp.asarray(tape.torso)
        squared = ((points[:, first] - points[:, second]) ** 2).sum(axis=1)
        # The root's slope is infinite at zero, where faces that are not cut are.
        total = total + jnp.where(both, jnp.sqrt(jnp.where(both, squared + 1e-12, 1.0)), 0.0).sum()
    hem = jnp.asarray(tape.hem)
    return total, jnp.where(hem, vertices[:, 1], 0.0).sum() / hem.sum() - tape.ground
