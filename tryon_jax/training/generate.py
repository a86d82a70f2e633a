"""Simulating the dataset: a list of independent tasks that any number of processes may work on.

A task writes one file in one step and does nothing where the file exists, so work can stop at any moment, and be done
twice without harm.
"""

import functools
import json
import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.stats import qmc

from tryon_jax.body import load_body
from tryon_jax.garment import Design, dense_template, placement, remesh
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, dress, sweep
from tryon_jax.physics.fabrics import Fabric, load_fabric
from tryon_jax.physics.solver import ClothState, SolverSettings, StepReport
from tryon_jax.training.dataset import (
    STATISTICS,
    DatasetConfig,
    load_arrays,
    mean_path,
    mesh_path,
    ray_path,
    read_config,
    save_arrays,
    template_path,
)
from tryon_jax.training.inspect import Inspector
from tryon_jax.training.protocol import Protocol, make_protocol

TEMPLATE_PULL = 0.02
"""Weight of the pull in `fit_template`, in garment vertices."""
TEMPLATE_SEED = 7
"""Seed of the Sobol sequence of designs for R_mean."""


@dataclass(frozen=True)
class Task:
    """One file of the dataset: kind is "mean", "ray" or "template"."""

    kind: str
    garment: str = ""
    fabric: str = ""
    number: int = 0
    """Ray, or number of the template design."""

    def path(self, root: Path) -> Path:
        """The file that this task writes."""
        if self.kind == "mean":
            return mean_path(root, self.garment, self.fabric)
        if self.kind == "ray":
            return ray_path(root, self.garment, self.fabric, self.number)
        return template_path(root, self.number)


def plan(config: DatasetConfig, garments: Sequence[str], rays: int, templates: int) -> list[list[Task]]:
    """Tasks in waves: drapes on the mean body, then templates and rays, which read or start from those drapes.

    Rays come in the protocol's order over all garments, so that any beginning of the list covers everything evenly.
    """
    protocol = make_protocol(config.num_betas)
    means = [Task("mean", garment, fabric) for garment in garments for fabric in config.fabrics]
    return [
        means,
        [Task("template", number=k) for k in range(templates)],
        [replace(task, kind="ray", number=ray) for ray in protocol.order[:rays] for task in means],
    ]


def run_task(root: str, task: Task) -> str:
    """Do a task unless its file exists; returns a line for the log ("" when there was nothing to do)."""
    folder = Path(root)
    if task.path(folder).exists():
        return ""
    bench = _bench(root)
    if task.kind == "mean":
        return bench.simulate_mean(task)
    if task.kind == "ray":
        return bench.simulate_ray(task)
    return bench.simulate_template(task)


def end_with_parent() -> None:
    """Let this worker end when the process that started it does, even if that is killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def template_designs(manifest: Manifest, count: int) -> list[Design]:
    """Designs for R_mean: the training designs, then a Sobol sequence over the whole space."""
    designs = list(manifest.training)
    space = manifest.space
    extra = max(0, count - len(designs))
    if extra:
        sobol = qmc.Sobol(len(space.names), seed=TEMPLATE_SEED)
        unit = sobol.random_base2(max(1, int(np.ceil(np.log2(extra)))))[:extra]
        for k, row in enumerate(unit):
            values = space.minimum + row * (space.maximum - space.minimum)
            designs.append(space.design(f"sobol-{k}", **dict(zip(space.names, map(float, values), strict=True))))
    return designs[:count]


@functools.lru_cache(maxsize=1)
def _bench(root: str) -> "Bench":
    return Bench(Path(root))


class Bench:
    """What a worker process keeps between tasks: body, manifest, fabrics and the last garments."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.config = read_config(root)
        self.manifest = load_manifest()
        self.protocol: Protocol = make_protocol(self.config.num_betas)
        self.obstacle = Obstacle(load_body(self.config.body))
        self.inspector = Inspector(self.obstacle)
        self.settings, self.equilibrium = SolverSettings(), Equilibrium()
        self.fabric = functools.lru_cache(load_fabric)
        self.garment = functools.lru_cache(maxsize=8)(self._garment)

    def _garment(self, name: str) -> tuple[dict[str, np.ndarray], Cloth]:
        """A garment's stored mesh and rest state. The file is the truth: φ runs only where there is none yet."""
        path = mesh_path(self.root, name)
        if not path.exists():
            label, seed = name.rsplit("-", 1)
            mesh = remesh(self.manifest.space, self.manifest.design(label), self.config.target_area, seed=int(seed))
            save_arrays(
                path,
                {
                    "faces": mesh.faces.astype(np.int32),
                    "uv": mesh.uv,
                    "faces_uv": mesh.faces_uv.astype(np.int32),
                    "template_vertices": mesh.template_vertices.astype(np.int32),
                    "template_weights": mesh.template_weights,
                    "design": np.asarray(mesh.design.values, float),
                    "start": placement(mesh),
                },
            )
        mesh = load_arrays(path)
        return mesh, build_cloth(mesh["faces"], mesh["uv"], mesh["faces_uv"], len(mesh["start"]))

    def _dress(self, mesh_start: np.ndarray, cloth: Cloth, fabric: Fabric) -> Drape:
        mean_body = (0.0,) * self.config.num_betas
        return dress(mesh_start, cloth, fabric, self.obstacle, self.settings, self.equilibrium, mean_body)

    def simulate_mean(self, task: Task) -> str:
        """Dress the mean body."""
        mesh, cloth = self.garment(task.garment)
        fabric = self.fabric(task.fabric)
        drape = self._dress(mesh["start"], cloth, fabric)
        statistics = self.inspector.statistics(drape, mesh["faces"], cloth, fabric)
        count = drape.num_vertices
        arrays = {"vertices": drape.vertices, "slip": np.asarray(drape.state.slip)[:count]}
        arrays |= {key: np.float32(statistics[key]) for key in STATISTICS}
        save_arrays(task.path(self.root), arrays | {"versions": _versions()})
        return f"{task.garment} {task.fabric}: {_line(statistics)}"

    def simulate_ray(self, task: Task) -> str:
        """Follow one ray from the drape on the mean body."""
        mesh, cloth = self.garment(task.garment)
        fabric = self.fabric(task.fabric)
        before = load_arrays(mean_path(self.root, task.garment, task.fabric))
        drape = self._resume(before, cloth)
        ray = self.protocol.rays[task.number]
        vertices, rows = [], []
        for current in sweep(drape, ray, cloth, fabric, self.obstacle, self.settings, self.equilibrium):
            vertices.append(current.vertices)
            rows.append(self.inspector.statistics(current, mesh["faces"], cloth, fabric))
        table = {key: np.array([row[key] for row in rows], np.float32) for key in STATISTICS}
        arrays = {"vertices": np.stack(vertices), "betas": ray, "test": self.protocol.test[task.number]}
        save_arrays(task.path(self.root), arrays | table | {"versions": _versions()})
        return f"{task.garment} {task.fabric} ray {task.number}: {_line(rows[-1])}"

    def _resume(self, before: dict[str, np.ndarray], cloth: Cloth) -> Drape:
        count, padded = len(before["vertices"]), cloth.vertex_areas.shape[0]
        x = np.full((padded, 3), 5.0, np.float32)
        slip = np.zeros_like(x)
        x[:count], slip[:count] = before["vertices"], before["slip"]
        state = ClothState(
            jnp.asarray(x), jnp.zeros((padded, 3)), jnp.asarray(slip), jnp.zeros(padded + len(cloth.faces), jnp.int32)
        )
        zero = np.zeros(self.config.num_betas)
        scalar, none = jnp.zeros(()), jnp.zeros((), jnp.int32)
        report = StepReport(scalar, scalar, scalar, none, none)
        return Drape(state, zero, self.obstacle.surface(zero), report, count)

    def simulate_template(self, task: Task) -> str:
        """The template's drape of one design on the mean body, averaged over the fabrics."""
        design = template_designs(self.manifest, task.number + 1)[task.number]
        if self.config.dense_vertices:
            template, statistics = self._dense_template(design)
        else:
            template, statistics = self._fitted_template(design)
        arrays = {"design": np.asarray(design.values, float), "template": template}
        arrays |= {key: np.float32(statistics[key]) for key in STATISTICS}
        save_arrays(task.path(self.root), arrays | {"versions": _versions()})
        return f"template {task.number} {design}: {_line(statistics)}"

    def _fitted_template(self, design: Design) -> tuple[np.ndarray, dict[str, float]]:
        """The template nearest to drapes at working density: the M̄ that the other networks start from is then
        unbiased. (Drapes of a denser mesh hang 4 to 10 mm elsewhere, which R_smooth would have to unlearn.)"""
        mesh = remesh(self.manifest.space, design, self.config.target_area, seed=self.manifest.training_seeds[0])
        cloth = build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, mesh.num_vertices)
        drapes, statistics = [], []
        for name in self.config.fabrics:
            fabric = self.fabric(name)
            drape = self._dress(placement(mesh), cloth, fabric)
            drapes.append(drape.vertices)
            statistics.append(self.inspector.statistics(drape, mesh.faces, cloth, fabric))
        average = np.mean(drapes, axis=0)
        return fit_template(mesh.template_vertices, mesh.template_weights, average), statistics[0]

    def _dense_template(self, design: Design) -> tuple[np.ndarray, dict[str, float]]:
        """The drape of the dense mesh in the first fabric, downsampled (the paper's way)."""
        dense = dense_template(self.manifest.space, design, self.config.dense_vertices)
        mesh = dense.mesh
        fabric = self.fabric(self.config.fabrics[0])
        cloth = build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, mesh.num_vertices)
        drape = self._dress(placement(mesh), cloth, fabric)
        return dense.downsample(drape.vertices), self.inspector.statistics(drape, mesh.faces, cloth, fabric)


def fit_template(
    corners: Int[np.ndarray, "V 3"], weights: Float[np.ndarray, "V 3"], vertices: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "T 3"]:
    """The template whose interpolation W T̄ is nearest to a drape, in least squares.

    A weak pull towards local averages settles template vertices that few garment vertices see.
    """
    size = int(corners.max()) + 1
    rows = np.repeat(np.arange(len(corners)), 3)
    interpolation = sp.csr_array((weights.ravel(), (rows, corners.ravel())), shape=(len(corners), size))
    seen = np.maximum(np.asarray(interpolation.sum(axis=0)), 1e-9)
    local = (interpolation.T @ vertices) / seen[:, None]
    system = (interpolation.T @ interpolation).toarray() + TEMPLATE_PULL * np.eye(size)
    return np.linalg.solve(system, interpolation.T @ vertices + TEMPLATE_PULL * local)


def garment_names(manifest: Manifest, designs: Sequence[str], seeds: Sequence[int]) -> list[str]:
    """Names of garments, design-major; every design is checked against the manifest."""
    return [f"{manifest.design(label).label}-{seed}" for label in designs for seed in seeds]


def _versions() -> str:
    return json.dumps({name: version(name) for name in ("jax", "numpy", "scipy")})


def _line(statistics: dict[str, float]) -> str:
    return (
        f"residual {statistics['residual']:.3f}, depth {1e3 * statistics['depth']:+.1f} mm, "
        f"tension {statistics['tension']:.0f} N/m, self-intersecting {100 * statistics['self_intersections']:.2f} %"
    )
