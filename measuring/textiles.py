"""Scenes of textile tests for the simulator: samples of fabric, the shapes they lie on, and how they are run."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import Delaunay

from tryon_jax.contact.closest_points import closest_faces
from tryon_jax.contact.surface import Surface, build_surface, nearest_vertices
from tryon_jax.physics.body_contact import sample_points
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.fabrics import GRID, Fabric, load_fabric
from tryon_jax.physics.solver import StepReport, solve
from tryon_jax.physics.state import ClothState, SolverSettings, resting

FAR = 5.0
run_solver = jax.jit(solve)


def sample_fabric(name: str) -> Fabric:
    """A fabric under one common name: names are part of the compiled function, ten of them would compile ten times."""
    return replace(load_fabric(name), name="sample")


def linear_fabric(warp: float, shear: float, bending: float, density: float) -> Fabric:
    """A fabric of the same stiffness at every strain and curvature, for answers in closed form."""
    stiffness = np.broadcast_to(np.array([warp, 0.0, warp, shear]), (GRID, GRID, GRID, 4))
    return Fabric(
        density=jnp.asarray(density),
        stretch_table=jnp.asarray(stiffness),
        bending=jnp.full((3, 5), bending),
        friction=jnp.asarray(0.3),
        thickness=jnp.asarray(0.004),
        name="sample",
    )


def strip(columns: int, rows: int, width: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Faces and UV of a rectangle of columns x rows cells, diagonals alternating."""
    u, v = np.meshgrid(np.linspace(0, width, columns + 1), np.linspace(0, height, rows + 1), indexing="ij")
    i, j = (index.ravel() for index in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    a, b = i * (rows + 1) + j, (i + 1) * (rows + 1) + j
    odd = ((i + j) % 2 == 1)[:, None]
    one = np.where(odd, np.stack([a, b, b + 1], axis=1), np.stack([a, b, a + 1], axis=1))
    two = np.where(odd, np.stack([a, b + 1, a + 1], axis=1), np.stack([b, b + 1, a + 1], axis=1))
    return np.concatenate([one, two]), np.stack([u.ravel(), v.ravel()], axis=1)


def disc(radius: float, edge: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Faces and UV of a round sample: rings of points, jittered so that no direction of the mesh is special."""
    rng = np.random.default_rng(seed)
    count = round(radius / (edge * 0.866))
    rings = [np.zeros((1, 2))]
    for k in range(1, count + 1):
        r = radius * k / count
        number = max(6, round(2 * np.pi * r / edge))
        angle = 2 * np.pi * (np.arange(number) + rng.uniform()) / number
        ring = r * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        jitter = 0.12 * edge * rng.normal(size=ring.shape)
        rings.append(ring + (jitter if k < count else 0))
    uv = np.concatenate(rings)
    faces = Delaunay(uv).simplices.astype(np.int64)
    a, b, c = (uv[faces[:, k]] for k in range(3))
    turn = np.cross(np.c_[b - a, np.zeros(len(a))], np.c_[c - a, np.zeros(len(a))])[:, 2]
    faces[turn < 0] = faces[turn < 0][:, ::-1]
    # Slivers between border points have no area to speak of.
    return faces[np.abs(turn) > 1e-3 * edge**2], uv


def lathe(profile: np.ndarray, segments: int = 96) -> Surface:
    """Closed surface of revolution about y; the profile runs from the axis over the top to the axis below."""
    angle = 2 * np.pi * np.arange(segments) / segments
    inner = profile[1:-1]
    rings = [np.stack([r * np.cos(angle), np.full(segments, y), r * np.sin(angle)], axis=1) for r, y in inner]
    vertices = np.concatenate([[[0, profile[0, 1], 0]], *rings, [[0, profile[-1, 1], 0]]])
    k = np.arange(segments)
    after = (k + 1) % segments
    last = len(vertices) - 1
    faces = [np.stack([np.zeros(segments, int), 1 + after, 1 + k], axis=1)]
    for ring in range(len(inner) - 1):
        a, b = 1 + ring * segments, 1 + (ring + 1) * segments
        faces += [
            np.stack([a + k, a + after, b + k], axis=1),
            np.stack([a + after, b + after, b + k], axis=1),
        ]
    end = 1 + (len(inner) - 1) * segments
    faces.append(np.stack([np.full(segments, last), end + k, end + after], axis=1))
    return build_surface(vertices.astype(np.float32), np.concatenate(faces))


def pedestal(radius: float = 0.09, fillet: float = 0.002, depth: float = 0.25) -> Surface:
    """A round table with its top at y = 0."""
    turn = np.linspace(0, np.pi / 2, 5)
    top = [[0.0, 0.0]] + [[r, 0.0] for r in np.linspace(0.2, 1, 5) * (radius - fillet)]
    rim = np.stack([radius - fillet + fillet * np.sin(turn), fillet * np.cos(turn) - fillet], axis=1)[1:]
    side = [[radius, -y] for y in np.linspace(0, depth, 12)[1:]]
    return lathe(np.concatenate([top, rim, side, [[0.0, -depth]]]))


def plate(tilt: float = 0.0) -> Surface:
    """A large thick plate with its upper side through the origin, tilted about z (radians)."""
    u = np.linspace(-2, 2, 5)
    faces, uv = strip(4, 4, 4.0, 4.0)
    upper = np.stack([uv[:, 0] - 2, np.zeros(len(uv)), 2 - uv[:, 1]], axis=1)
    lower = upper - [0, 1, 0]
    border = np.concatenate([5 * np.arange(5), 20 + np.arange(1, 5), 5 * np.arange(3, -1, -1) + 4, np.arange(3, 0, -1)])
    after = np.roll(border, -1)
    count = len(u) ** 2
    side = np.concatenate(
        [np.stack([border, border + count, after], axis=1), np.stack([after, border + count, after + count], axis=1)]
    )
    all_faces = np.concatenate([faces, faces[:, ::-1] + count, side])
    cos, sin = np.cos(tilt), np.sin(tilt)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return build_surface((np.concatenate([upper, lower]) @ turn.T).astype(np.float32), all_faces)


@dataclass(frozen=True, eq=False)
class Result:
    """How a run ended."""

    vertices: np.ndarray
    state: ClothState
    report: StepReport
    steps: int


def start_at(points: np.ndarray, cloth: Cloth) -> ClothState:
    """A sample at rest at `points`, its padding far away."""
    x = np.full((len(cloth.vertex_areas), 3), FAR, np.float32)
    x[: len(points)] = points
    at = jnp.asarray(x)
    return resting(at, jnp.zeros(len(x) + len(cloth.faces), jnp.int32))


def settle(
    faces: np.ndarray,
    uv: np.ndarray,
    points: np.ndarray,
    fabric: Fabric,
    surface: Surface,
    settings: SolverSettings,
    *,
    pinned: np.ndarray | None = None,
    tolerance: float = 3e-3,
    most: int = 1000,
    state: ClothState | None = None,
    cloth: Cloth | None = None,
) -> Result:
    """Run a sample to equilibrium, searching its closest points anew every 20 steps; or all steps if tolerance is 0."""
    cloth = build_cloth(faces, uv, faces, len(uv)) if cloth is None else cloth
    current = start_at(points, cloth) if state is None else state
    held = np.zeros(len(cloth.vertex_areas), bool)
    if pinned is not None:
        held[pinned] = True
    still = jnp.zeros_like(surface.vertices)
    steps, goal = 0, jnp.asarray(tolerance, jnp.float32)
    while steps < most:
        samples = sample_points(current.x, cloth)
        face = closest_faces(surface, samples, nearest_vertices(surface, samples))
        piece = jnp.asarray(min(20, most - steps), jnp.int32)
        current, report = run_solver(
            replace(current, face=face), cloth, fabric, surface, settings, still, jnp.asarray(held), goal, piece
        )
        steps += int(report.steps)
        if float(report.residual) <= tolerance:
            break
    return Result(np.asarray(current.x)[: len(points)], current, report, steps)


def shadow_area(vertices: np.ndarray, faces: np.ndarray, pixel: float = 5e-4) -> float:
    """Area of the vertical projection, overlapping folds counted once, by drawing the triangles on a grid."""
    flat = (vertices[:, [0, 2]] - vertices[:, [0, 2]].min(axis=0)) / pixel
    size = np.ceil(flat.max(axis=0)).astype(int) + 2
    drawn = np.zeros(size, bool)
    for triangle in flat[faces]:
        low, high = np.floor(triangle.min(axis=0)).astype(int), np.ceil(triangle.max(axis=0)).astype(int) + 1
        i, j = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]), indexing="ij")
        p = np.stack([i, j], axis=-1) + 0.5
        a, b, c = triangle
        signs = [
            (q[0] - o[0]) * (p[..., 1] - o[1]) - (q[1] - o[1]) * (p[..., 0] - o[0]) for o, q in ((a, b), (b, c), (c, a))
        ]
        inside = np.all([s >= 0 for s in signs], axis=0) | np.all([s <= 0 for s in signs], axis=0)
        drawn[low[0] : high[0], low[1] : high[1]] |= inside
    return float(drawn.sum()) * pixel**2
