"""Doing the tasks of the dataset: from the pattern to files of drapes, one by one or side by side."""

import functools
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tryon_jax.body import load_body
from tryon_jax.garment import Design, dense_template, placement, remesh
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.physics.batch import dress_many, sweep_many
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.dressing import Diverged, Drape, Equilibrium, Obstacle, dress, sweep
from tryon_jax.physics.fabrics import Fabric, load_fabric
from tryon_jax.physics.solver import SolverSettings, StepReport, resting
from tryon_jax.training.dataset import STATISTICS, load_arrays, mean_path, mesh_path, read_config, save_arrays
from tryon_jax.training.inspect import Inspector
from tryon_jax.training.plan import Task, template_designs
from tryon_jax.training.protocol import Protocol, make_protocol

TEMPLATE_PULL = 0.02
"""Weight of the pull in `fit_template`, in garment vertices."""
LOST: dict[str, float] = {key: float("inf") for key in STATISTICS}
"""Statistics of a shape whose simulation left the numbers: marked and excluded by every rule, never left out."""


class Worn(NamedTuple):
    """A garment about to be dressed."""

    start: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    cloth: Cloth
    fabric: Fabric


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

    def _worn(self, garment: str, fabric: str) -> Worn:
        mesh, cloth = self.garment(garment)
        return Worn(mesh["start"], mesh["faces"], cloth, self.fabric(fabric))

    def _dress(self, worn: Worn) -> Drape | None:
        """A drape on the mean body, or None where the simulation left the numbers."""
        mean_body = (0.0,) * self.config.num_betas
        try:
            return dress(worn.start, worn.cloth, worn.fabric, self.obstacle, self.settings, self.equilibrium, mean_body)
        except Diverged:
            return None

    def _dress_all(self, worn: Sequence[Worn]) -> list[Drape | None]:
        """The same side by side."""
        mean_body = (0.0,) * self.config.num_betas
        drapes: list[Drape | None] = [None] * len(worn)
        for lanes in _by_bucket([w.cloth for w in worn]):
            starts, _, cloths, fabrics = zip(*[worn[k] for k in lanes], strict=True)
            found = dress_many(starts, cloths, fabrics, self.obstacle, self.settings, self.equilibrium, mean_body)
            for k, drape in zip(lanes, found, strict=True):
                drapes[k] = _unless_lost(drape)
        return drapes

    def _statistics(self, drape: Drape | None, worn: Worn) -> dict[str, float]:
        if drape is None:
            return LOST
        return self.inspector.statistics(drape, worn.faces, worn.cloth, worn.fabric)

    # Drapes on the mean body

    def simulate_mean(self, task: Task) -> str:
        """Dress the mean body."""
        worn = self._worn(task.garment, task.fabric)
        return self._save_mean(task, worn, self._dress(worn))

    def simulate_means(self, tasks: Sequence[Task]) -> list[str]:
        """Dress the mean body in several garments side by side."""
        worn = [self._worn(task.garment, task.fabric) for task in tasks]
        return [self._save_mean(*each) for each in zip(tasks, worn, self._dress_all(worn), strict=True)]

    def _save_mean(self, task: Task, worn: Worn, drape: Drape | None) -> str:
        statistics = self._statistics(drape, worn)
        count = len(worn.start)
        vertices = worn.start.astype(np.float32) if drape is None else drape.vertices
        slip = np.zeros_like(vertices) if drape is None else np.asarray(drape.state.slip)[:count]
        self._save(task, {"vertices": vertices, "slip": slip} | _scalars(statistics))
        return f"{task.garment} {task.fabric}: {_line(statistics)}"

    # Rays

    def simulate_ray(self, task: Task) -> str:
        """Follow one ray from the drape on the mean body."""
        worn, ray = self._worn(task.garment, task.fabric), self.protocol.rays[task.number]
        first = self._resume(task, worn)
        if first is None:
            return self._save_ray(task, worn, [])
        obstacle, settings, equilibrium = self.obstacle, self.settings, self.equilibrium
        return self._save_ray(
            task, worn, _until_lost(sweep(first, ray, worn.cloth, worn.fabric, obstacle, settings, equilibrium))
        )

    def simulate_rays(self, tasks: Sequence[Task]) -> list[str]:
        """Follow several rays side by side."""
        worn = [self._worn(task.garment, task.fabric) for task in tasks]
        drapes: list[list[Drape]] = [[] for _ in tasks]
        for lanes in _by_bucket([w.cloth for w in worn]):
            started = [(k, first) for k in lanes if (first := self._resume(tasks[k], worn[k])) is not None]
            if not started:
                continue
            rays = np.stack([self.protocol.rays[tasks[k].number] for k, _ in started])
            cloths, fabrics = [worn[k].cloth for k, _ in started], [worn[k].fabric for k, _ in started]
            first = [drape for _, drape in started]
            lost: set[int] = set()
            for shapes in sweep_many(first, rays, cloths, fabrics, self.obstacle, self.settings, self.equilibrium):
                for (k, _), drape in zip(started, shapes, strict=True):
                    # What comes after a lost shape started from nowhere.
                    lost |= {k} if _unless_lost(drape) is None else set()
                    if k not in lost:
                        drapes[k].append(drape)
        return [self._save_ray(*each) for each in zip(tasks, worn, drapes, strict=True)]

    def _save_ray(self, task: Task, worn: Worn, drapes: Iterable[Drape]) -> str:
        """Store a ray; shapes after its last drape are marked as lost and repeat the vertices before them."""
        ray = self.protocol.rays[task.number]
        vertices, rows = [], []
        for drape in drapes:
            vertices.append(drape.vertices)
            rows.append(self._statistics(drape, worn))
        before = vertices[-1] if vertices else load_arrays(mean_path(self.root, task.garment, task.fabric))["vertices"]
        vertices += [before] * (len(ray) - len(vertices))
        rows += [LOST] * (len(ray) - len(rows))
        table = {key: np.array([row[key] for row in rows], np.float32) for key in STATISTICS}
        self._save(
            task, {"vertices": np.stack(vertices), "betas": ray, "test": self.protocol.test[task.number]} | table
        )
        return f"{task.garment} {task.fabric} ray {task.number}: {_line(rows[-1])}"

    def _resume(self, task: Task, worn: Worn) -> Drape | None:
        """The stored drape on the mean body, or None where that one was lost."""
        before = load_arrays(mean_path(self.root, task.garment, task.fabric))
        if not np.isfinite(before["residual"]):
            return None
        count, padded = len(before["vertices"]), worn.cloth.vertex_areas.shape[0]
        x = np.full((padded, 3), 5.0, np.float32)
        slip = np.zeros_like(x)
        x[:count], slip[:count] = before["vertices"], before["slip"]
        face = jnp.zeros(padded + len(worn.cloth.faces), jnp.int32)
        state = replace(resting(jnp.asarray(x), face), slip=jnp.asarray(slip))
        zero = np.zeros(self.config.num_betas)
        scalar, none = jnp.zeros(()), jnp.zeros((), jnp.int32)
        report = StepReport(scalar, scalar, scalar, none, none)
        return Drape(state, zero, self.obstacle.surface(zero), report, count)

    # Templates for R_mean

    def simulate_template(self, task: Task) -> str:
        """The template's drape of one design on the mean body, averaged over the fabrics."""
        design = template_designs(self.manifest, task.number + 1)[task.number]
        if self.config.dense_vertices:
            return self._save_template(task, design, *self._dense_template(design))
        mesh, worn = self._template_garment(design)
        return self._save_template(task, design, *self._fit(mesh, worn, [self._dress(w) for w in worn]))

    def simulate_templates(self, tasks: Sequence[Task]) -> list[str]:
        """Several designs side by side (dense ones one by one: they fill a device)."""
        if self.config.dense_vertices:
            return [self.simulate_template(task) for task in tasks]
        designs = template_designs(self.manifest, max(task.number for task in tasks) + 1)
        garments = [self._template_garment(designs[task.number]) for task in tasks]
        drapes = iter(self._dress_all([w for _, worn in garments for w in worn]))
        lines = []
        for task, (mesh, worn) in zip(tasks, garments, strict=True):
            fitted = self._fit(mesh, worn, [next(drapes) for _ in worn])
            lines.append(self._save_template(task, designs[task.number], *fitted))
        return lines

    def _template_garment(self, design: Design) -> tuple[Any, list[Worn]]:
        mesh = remesh(self.manifest.space, design, self.config.target_area, seed=self.manifest.training_seeds[0])
        cloth = build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, mesh.num_vertices)
        start = placement(mesh)
        return mesh, [Worn(start, mesh.faces, cloth, self.fabric(name)) for name in self.config.fabrics]

    def _fit(
        self, mesh: Any, worn: list[Worn], drapes: list[Drape | None]
    ) -> tuple[np.ndarray | None, dict[str, float]]:
        """The template nearest to drapes at working density: the M̄ that the other networks start from is then
        unbiased. (Drapes of a denser mesh hang 4 to 10 mm elsewhere, which R_smooth would have to unlearn.)"""
        whole = [drape.vertices for drape in drapes if drape is not None]
        if len(whole) < len(drapes):
            return None, LOST
        average = np.mean(whole, axis=0)
        return fit_template(mesh.template_vertices, mesh.template_weights, average), self._statistics(
            drapes[0], worn[0]
        )

    def _dense_template(self, design: Design) -> tuple[np.ndarray | None, dict[str, float]]:
        """The drape of the dense mesh in the first fabric, downsampled (the paper's way)."""
        dense = dense_template(self.manifest.space, design, self.config.dense_vertices)
        mesh = dense.mesh
        cloth = build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, mesh.num_vertices)
        worn = Worn(placement(mesh), mesh.faces, cloth, self.fabric(self.config.fabrics[0]))
        drape = self._dress(worn)
        return None if drape is None else dense.downsample(drape.vertices), self._statistics(drape, worn)

    def _save_template(
        self, task: Task, design: Design, template: np.ndarray | None, statistics: dict[str, float]
    ) -> str:
        stored = np.zeros((0, 3)) if template is None else template
        self._save(task, {"design": np.asarray(design.values, float), "template": stored} | _scalars(statistics))
        return f"template {task.number} {design}: {_line(statistics)}"

    def _save(self, task: Task, arrays: dict[str, Any]) -> None:
        save_arrays(task.path(self.root), arrays | {"versions": _versions()})


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


def _by_bucket(cloths: Sequence[Cloth]) -> list[list[int]]:
    """Indices of the cloths of each padded size."""
    sizes = [cloth.vertex_areas.shape[0] for cloth in cloths]
    return [[k for k, other in enumerate(sizes) if other == size] for size in sorted(set(sizes))]


def _unless_lost(drape: Drape) -> Drape | None:
    return drape if np.isfinite(float(drape.report.residual)) else None


def _until_lost(drapes: Iterator[Drape]) -> Iterator[Drape]:
    try:
        yield from drapes
    except Diverged:
        return


def _scalars(statistics: dict[str, float]) -> dict[str, np.float32]:
    return {key: np.float32(statistics[key]) for key in STATISTICS}


def _versions() -> str:
    return json.dumps({name: version(name) for name in ("jax", "numpy", "scipy")})


def _line(statistics: dict[str, float]) -> str:
    if not np.isfinite(statistics["residual"]):
        return "lost: the simulation left the numbers"
    return (
        f"residual {statistics['residual']:.3f}, depth {1e3 * statistics['depth']:+.1f} mm, "
        f"tension {statistics['tension']:.0f} N/m, self-intersecting {100 * statistics['self_intersections']:.2f} %"
    )
