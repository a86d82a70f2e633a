"""Statistics of drapes whose answers are known: patches of shells around a ball."""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.dressing import Drape, Obstacle
from tryon_jax.physics.fabrics import Fabric, load_fabric
from tryon_jax.physics.solver import StepReport
from tryon_jax.physics.state import resting
from tryon_jax.training.dataset import STATISTICS, is_good
from tryon_jax.training.inspect import Inspector, principal_tension

sys.path.insert(0, str(Path(__file__).parents[1] / "physics"))
from round_body import GROWTH, RADIUS, make_ball


@pytest.fixture(scope="module")
def inspector() -> Inspector:
    return Inspector(Obstacle(make_ball()))


def shell(over: float) -> tuple[np.ndarray, np.ndarray]:
    """The upper half of a finer ball around the body."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS + over)
    keep = (ball.vertices[ball.faces][:, :, 1] > -1e-9).all(axis=1)
    faces = np.asarray(ball.faces)[keep]
    used, index = np.unique(faces, return_inverse=True)
    return np.asarray(ball.vertices)[used], index.reshape(faces.shape)


def as_drape(vertices: np.ndarray, inspector: Inspector, beta: float = 0.0, residual: float = 0.005) -> Drape:
    x = jnp.asarray(vertices, jnp.float32)
    state = resting(x, jnp.zeros(len(x), jnp.int32))
    zero = jnp.zeros(())
    report = StepReport(jnp.asarray(residual), zero, zero, jnp.asarray(12), jnp.asarray(30))
    betas = np.array([beta])
    return Drape(state, betas, inspector.obstacle.surface(betas), report, len(x))


@pytest.mark.parametrize("over", [0.004, -0.002])
def test_penetration_of_a_shell(inspector: Inspector, over: float) -> None:
    vertices, faces = shell(over)
    depth, inside = inspector.penetration(as_drape(vertices, inspector), faces)
    # Faces sag towards the middle by a fifth of a millimetre.
    assert depth == pytest.approx(-over, abs=3e-4)
    assert inside == (1.0 if over < 0 else 0.0)


def test_penetration_follows_the_shape_of_the_body(inspector: Inspector) -> None:
    vertices, faces = shell(0.004)
    depth, inside = inspector.penetration(as_drape(vertices, inspector, beta=1.0), faces)
    assert depth == pytest.approx(GROWTH - 0.004, abs=3e-4)
    assert inside == 1.0


def test_faces_count_not_only_vertices(inspector: Inspector) -> None:
    """One face whose corners are outside and whose middle is deep inside."""
    a = RADIUS + 0.01
    vertices = np.array([[a, 0, 0], [0, a, 0], [0, 0, a]])
    depth, inside = inspector.penetration(as_drape(vertices, inspector), np.array([[0, 1, 2]]))
    assert depth == pytest.approx(RADIUS - a / np.sqrt(3), abs=2e-3)
    assert inside == pytest.approx(4 / 7)


def flat(stretch: tuple[float, float] = (1.0, 1.0)) -> tuple[np.ndarray, np.ndarray, Cloth, Fabric]:
    u, v = np.meshgrid(np.linspace(0, 0.1, 6), np.linspace(0, 0.1, 6), indexing="ij")
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    faces = np.array([[i * 6 + j, (i + 1) * 6 + j, (i + 1) * 6 + j + 1] for i in range(5) for j in range(5)])
    faces = np.concatenate([faces, faces[:, [0, 2, 2]] + [0, 0, -6]])
    cloth = build_cloth(faces, uv, faces, 36, bucket=36)
    points = np.stack([stretch[0] * uv[:, 0], np.full(36, 1.0), -stretch[1] * uv[:, 1]], axis=1)
    return points, faces, cloth, load_fabric("gray-interlock")


def test_tension_of_a_stretched_sheet() -> None:
    points, faces, cloth, fabric = flat((1.1, 1.0))
    tension = principal_tension(points.astype(np.float32), cloth, fabric)[: len(faces)]
    assert np.ptp(tension) < 1e-2 * tension.mean()
    # Pulled 10 % along the warp: between the stiffness at rest and at 1/6, times the strain.
    strain = 0.5 * (1.1**2 - 1)
    assert 41 * strain < tension.mean() < 130 * strain
    rest, *_ = flat()
    assert np.abs(principal_tension(rest.astype(np.float32), cloth, fabric)[: len(faces)]).max() < 0.1


def test_statistics_of_one_drape(inspector: Inspector) -> None:
    points, faces, cloth, fabric = flat((1.0, 1.05))
    statistics = inspector.statistics(as_drape(points, inspector, residual=0.015), faces, cloth, fabric)
    assert set(statistics) == set(STATISTICS)
    assert statistics["residual"] == pytest.approx(0.015)
    assert statistics["steps"] == 12
    assert statistics["stretch"] == pytest.approx(1.05, abs=1e-3)
    assert statistics["self_intersections"] == 0
    assert statistics["depth"] < -0.5
    assert is_good({key: np.array([value]) for key, value in statistics.items()}).all()


def test_a_cloth_through_itself_is_seen(inspector: Inspector) -> None:
    points, faces, cloth, fabric = flat()
    points[-1] = [0.03, 0.99, -0.03]
    points[-2] = [0.03, 1.01, -0.035]
    statistics = inspector.statistics(as_drape(points, inspector), faces, cloth, fabric)
    assert statistics["self_intersections"] > 0.02
    assert not is_good({key: np.array([value]) for key, value in statistics.items()}).any()
