"""Simulated drapes of lowered arms: each descent starts from a drape of the dataset, in T-pose, and is one file.

    ROOT/stances/<garment>_<fabric>_<ray>-<shape>.npz    vertices [S, V, 3] and what they start from, degrees [S],
                                                         residual [S], betas, test

Ray and shape say which drape of the dataset it is; `mean` is the one on the mean body.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from tryon_jax.body import load_body
from tryon_jax.body.stance import LOWEST
from tryon_jax.garment.manifest import Manifest
from tryon_jax.graph.skinning import garment_skinning
from tryon_jax.physics.cloth import build_cloth
from tryon_jax.physics.dressing import Equilibrium, Obstacle, relax, until_diverged
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.physics.stance import Stance, StanceObstacle, lower_arms
from tryon_jax.physics.state import SolverSettings
from tryon_jax.training.dataset import MAX_RESIDUAL, is_good, load_arrays, mean_path, mesh_path, save_arrays
from tryon_jax.training.plan import split_name
from tryon_jax.training.protocol import make_protocol

STEPS = 200
"""Solver steps of one stance at most."""
MEAN = -1
"""Stands for the mean body in place of a ray."""


@dataclass(frozen=True)
class DescentTask:
    """One file: the drape of the dataset that it starts from."""

    garment: str
    fabric: str
    ray: int = MEAN
    shape: int = 0
    """Row of the ray."""

    def path(self, root: Path) -> Path:
        """The file that this task writes."""
        return root / "stances" / f"{self.garment}_{self.fabric}_{self.body_name}.npz"

    @property
    def body_name(self) -> str:
        """Of the body, as in the file's name."""
        return "mean" if self.ray == MEAN else f"{self.ray:02d}-{self.shape}"


@dataclass(frozen=True, eq=False)
class Descent:
    """What one file holds."""

    betas: Float[np.ndarray, " b"]
    test: bool
    """The body shape is for testing."""
    start: Float[np.ndarray, "V 3"]
    """The drape in T-pose, metres."""
    degrees: Float[np.ndarray, " S"]
    """Of the arms below the horizontal."""
    vertices: Float[np.ndarray, "S V 3"]
    """The drape in each stance, metres."""
    at_rest: Bool[np.ndarray, " S"]


def plan_descents(
    root: Path, manifest: Manifest, garments: Sequence[str], fabrics: Sequence[str], bodies: int
) -> list[DescentTask]:
    """Descents of garments whose drapes are there, the mean body first, then one body of each ray in turn.

    Any beginning of the list covers all garments evenly. Garments that are trained on descend on training shapes,
    others on test shapes.

    Args:
        root: Folder of the dataset.
        manifest: Splits of designs and topologies.
        garments: Names of garments.
        fabrics: Names of fabrics.
        bodies: Bodies of each.
    """
    order = {ray: k for k, ray in enumerate(make_protocol(2).order)}
    listed: list[list[DescentTask]] = [[] for _ in range(bodies)]
    for garment in garments:
        wanted = manifest.split(*split_name(garment)) != "training"
        for fabric in fabrics:
            if not (mean := mean_path(root, garment, fabric)).exists():
                continue
            found = [DescentTask(garment, fabric)] if is_good(load_arrays(mean)) else []
            paths = sorted((root / "rays").glob(f"{garment}_{fabric}_*.npz"), key=lambda p: order[_number(p)])
            for k, path in enumerate(paths[: bodies - 1]):
                ray = load_arrays(path)
                if "slip" not in ray:
                    # Other topologies are not followed along rays: nothing could start from their drapes.
                    continue
                rows = np.flatnonzero(is_good(ray) & (ray["test"].astype(bool) == wanted))
                if len(rows):
                    # The outermost shape of one ray, one in the middle of the next.
                    row = rows[-1] if k % 2 == 0 else rows[(len(rows) - 1) // 2]
                    found.append(DescentTask(garment, fabric, _number(path), int(row)))
            for k, task in enumerate(found):
                listed[k].append(task)
    return [task for group in listed for task in group]


def run_descent(root: str, task: DescentTask) -> str:
    """Do one task; returns a line for the log, "" where its file is there.

    Args:
        root: Folder of the dataset.
        task: The task.
    """
    folder = Path(root)
    if task.path(folder).exists():
        return ""
    betas, test, vertices, slip = _start(folder, task)
    mesh = load_arrays(mesh_path(folder, task.garment))
    mean = load_arrays(mean_path(folder, task.garment, task.fabric))["vertices"]
    cloth = build_cloth(mesh["faces"], mesh["uv"], mesh["faces_uv"], len(mesh["start"]))
    fabric, settings, equilibrium = load_fabric(task.fabric), SolverSettings(), Equilibrium(max_steps=STEPS)
    body = _obstacle()
    weights = garment_skinning(mean, mesh["faces"], body.body)
    laid = relax(vertices, slip, betas, cloth, fabric, body, settings, equilibrium, max_steps=0)
    obstacle = StanceObstacle(body, betas)
    # What comes before a divergence is stored, and nothing that starts from cloth that found no rest.
    stances: list[Stance] = []
    for stance in until_diverged(lower_arms(laid, weights, LOWEST, cloth, fabric, obstacle, settings, equilibrium)):
        stances.append(stance)
        if float(stance.drape.report.residual) > MAX_RESIDUAL:
            break
    residual = np.array([float(stance.drape.report.residual) for stance in stances], np.float32)
    save_arrays(
        task.path(folder),
        {
            "betas": betas,
            "test": test,
            "start": vertices,
            "degrees": np.array([stance.degrees for stance in stances], np.float32),
            "vertices": np.array([stance.drape.vertices for stance in stances], np.float32).reshape(
                -1, *vertices.shape
            ),
            "residual": residual,
        },
    )
    last = f"{stances[-1].degrees:g} degrees, residual {residual[-1]:.3f}" if stances else "diverged"
    return f"{task.garment} {task.fabric} {task.body_name}: {last}"


def descent_files(root: Path) -> list[Path]:
    """All files of a dataset's descents, sorted."""
    return sorted((root / "stances").glob("[!.]*.npz"))


def load_descents(root: Path, garment: str, fabric: str) -> list[Descent]:
    """All descents of a garment in a fabric.

    Args:
        root: Folder of the dataset.
        garment: <design label>-<topology seed>.
        fabric: Name.
    """
    found = []
    for path in sorted((root / "stances").glob(f"{garment}_{fabric}_*.npz")):
        a = load_arrays(path)
        at_rest = a["residual"] <= MAX_RESIDUAL
        found.append(Descent(a["betas"], bool(a["test"]), a["start"], a["degrees"], a["vertices"], at_rest))
    return found


def _start(root: Path, task: DescentTask) -> tuple[np.ndarray, bool, np.ndarray, np.ndarray]:
    """Betas, whether they are for testing, drape and slip."""
    if task.ray == MEAN:
        mean = load_arrays(mean_path(root, task.garment, task.fabric))
        return np.zeros(2), False, mean["vertices"], mean["slip"]
    ray = load_arrays(root / "rays" / f"{task.garment}_{task.fabric}_{task.ray:02d}.npz")
    row = task.shape
    return np.round(ray["betas"][row], 6), bool(ray["test"][row]), ray["vertices"][row], ray["slip"][row]


def _number(path: Path) -> int:
    return int(path.stem.rsplit("_", 1)[1])


@functools.lru_cache(maxsize=1)
def _obstacle() -> Obstacle:
    return Obstacle(load_body("female"))
