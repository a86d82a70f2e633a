"""Small cloths, fabrics and obstacles that tests of physics share, of one padded size so that they compile once."""

import jax
import jax.numpy as jnp
import numpy as np
import trimesh

from tryon_jax.contact.closest_points import closest_faces
from tryon_jax.contact.surface import Surface, build_surface, nearest_vertices
from tryon_jax.physics.body_contact import sample_points
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.fabrics import GRID, Fabric
from tryon_jax.physics.solver import StepReport, solve
from tryon_jax.physics.state import ClothState, SolverSettings, resting

BUCKET = 64
FAR = 5.0
jitted_solve = jax.jit(solve)


def sheet(columns: int, rows: int, width: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Faces and UV of a rectangle cut into columns x rows cells of two triangles, diagonals alternating."""
    u, v = np.meshgrid(np.linspace(0, width, columns + 1), np.linspace(0, height, rows + 1), indexing="ij")
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    faces = []
    for i in range(columns):
        for j in range(rows):
            a, b = i * (rows + 1) + j, (i + 1) * (rows + 1) + j
            c, d = b + 1, a + 1
            faces += [[a, b, c], [a, c, d]] if (i + j) % 2 else [[a, b, d], [b, c, d]]
    return np.array(faces), uv


def make_cloth(faces: np.ndarray, uv: np.ndarray, dtype: type = np.float64, bucket: int = BUCKET) -> Cloth:
    """Rest state of a mesh without seams."""
    return build_cloth(faces, uv, faces, len(uv), bucket=bucket, dtype=dtype)


def place(points: np.ndarray, cloth: Cloth) -> jax.Array:
    """Positions with padding vertices far away, in the cloth's precision."""
    x = np.full((len(cloth.vertex_areas), 3), FAR, np.asarray(cloth.vertex_areas).dtype)
    x[: len(points)] = points
    return jnp.asarray(x)


def horizontal(uv: np.ndarray, height: float = 0.0) -> np.ndarray:
    """A flat sheet about the y axis at some height, its front up."""
    middle = 0.5 * (uv.min(axis=0) + uv.max(axis=0))
    u, v = (uv - middle).T
    return np.stack([u, np.full(len(uv), height), -v], axis=1)


def wavy(uv: np.ndarray, seed: int, scale: float = 0.1) -> np.ndarray:
    """A sheet strained and bent at random; `scale` is relative to the mean edge."""
    rng = np.random.default_rng(seed)
    edge = np.sqrt(np.ptp(uv[:, 0]) * np.ptp(uv[:, 1]) / len(uv))
    points = horizontal(uv) + scale * edge * rng.normal(size=(len(uv), 3))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return points @ (rotation * np.sign(np.linalg.det(rotation))).T


def make_fabric(
    warp: float = 500.0,
    coupling: float = 0.0,
    weft: float | None = None,
    shear: float = 200.0,
    bending: float = 1e-5,
    density: float = 0.2,
    friction: float = 0.3,
    thickness: float = 0.004,
) -> Fabric:
    """A linear fabric: the same stiffness at every strain and curvature."""
    k = np.array([warp, coupling, warp if weft is None else weft, shear], float)
    return Fabric(
        density=jnp.asarray(density),
        stretch_table=jnp.asarray(np.broadcast_to(k, (GRID, GRID, GRID, 4))),
        bending=jnp.full((3, 5), bending),
        friction=jnp.asarray(friction),
        thickness=jnp.asarray(thickness),
        name="linear",
    )


def slab(tilt: float = 0.0, dtype: type = np.float64) -> Surface:
    """A thick 4 x 4 m plate whose upper side is y = 0, tilted about z; its normals are exact in the middle 2 x 2 m."""
    box = trimesh.creation.box(extents=(4.0, 1.0, 4.0)).subdivide().subdivide()
    cos, sin = np.cos(tilt), np.sin(tilt)
    vertices = (box.vertices - [0, 0.5, 0]) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]).T
    return build_surface(vertices.astype(dtype), np.asarray(box.faces))


def start(x: jax.Array, cloth: Cloth, surface: Surface) -> ClothState:
    """A state at rest."""
    samples = sample_points(x, cloth)
    face = closest_faces(surface, samples, nearest_vertices(surface, samples))
    return resting(x, face)


def run(
    state: ClothState,
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    settings: SolverSettings,
    steps: int,
    pinned: np.ndarray | None = None,
    tolerance: float = 0.0,
    motion: jax.Array | None = None,
) -> tuple[ClothState, StepReport]:
    """Some steps, all of them unless a tolerance is reached; `pinned` marks vertices that stay where they are."""
    held = np.zeros(len(cloth.vertex_areas), bool)
    if pinned is not None:
        held[pinned] = True
    motion = jnp.zeros_like(surface.vertices) if motion is None else motion
    goal, most = jnp.asarray(tolerance, state.x.dtype), jnp.asarray(steps, jnp.int32)
    return jitted_solve(state, cloth, fabric, surface, settings, motion, jnp.asarray(held), goal, most)


def relax(
    state: ClothState,
    cloth: Cloth,
    fabric: Fabric,
    surface: Surface,
    settings: SolverSettings,
    pinned: np.ndarray | None = None,
    tolerance: float = 1e-6,
    most: int = 800,
) -> tuple[ClothState, StepReport]:
    """Steps to equilibrium."""
    state, report = run(state, cloth, fabric, surface, settings, most, pinned, tolerance)
    assert float(report.residual) <= tolerance, f"no equilibrium: residual {float(report.residual):.2g}"
    return state, report
