"""Doing the tasks of the dataset: from the pattern to files of drapes (see `reference` for where each drape starts).

Tasks of one kind are done together: one by one on a CPU, side by side where several are handed over at once.
"""

import functools
import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tryon_jax.body import load_body
from tryon_jax.garment import dense_template, placement, remesh
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.nets.mlp import MeanDrape
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.dressing import Drape, Obstacle
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.dataset import (
    STATISTICS,
    guess_path,
    load_arrays,
    mean_path,
    mesh_path,
    ray_path,
    read_config,
    reference_path,
    save_arrays,
)
from tryon_jax.training.drape_solver import DrapeSolver, Subject
from tryon_jax.training.inspect import Inspector
from tryon_jax.training.plan import Task
from tryon_jax.training.protocol import Protocol, make_protocol
from tryon_jax.training.reference import Start, reference_mesh, start_from_mesh, start_from_reference, store_guess
from tryon_jax.training.template_fit import fit_template
from tryon_jax.tryon import load_pretrained

DIVERGED: dict[str, float] = {key: float("inf") for key in STATISTICS}
"""Statistics of a drape whose simulation diverged: stored and excluded by every rule, never left out."""


class Simulator:
    """What a worker process keeps between tasks: body, manifest, fabrics and the last garments."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.config = read_config(root)
        self.manifest = load_manifest()
        self.protocol: Protocol = make_protocol(self.config.num_betas)
        obstacle = Obstacle(load_body(self.config.body))
        self.inspector = Inspector(obstacle)
        self.solver = DrapeSolver(obstacle, self.config.num_betas)
        self.fabric = functools.lru_cache(load_fabric)
        self.garment = functools.lru_cache(maxsize=8)(self._garment)

    def run(self, tasks: Sequence[Task]) -> list[str]:
        """Do tasks of one kind and write their files; returns a line for the log for each."""
        work = {"reference": self._references, "mean": self._means, "template": self._templates, "ray": self._rays}
        return work[tasks[0].kind](tasks)

    def subject(self, garment: str, fabric: str) -> Subject:
        """A garment by its name, from its stored mesh, in a fabric."""
        return Subject(*self.garment(garment), self.fabric(fabric))

    def _garment(self, name: str) -> tuple[dict[str, np.ndarray], Cloth]:
        """A garment's stored mesh and rest state. The file is used where there is one: φ runs only where there is none
        yet."""
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

    @functools.cached_property
    def guess(self) -> MeanDrape:
        """R_mean by which drapes of one design are moved to another: the library's when the dataset was begun."""
        return store_guess(guess_path(self.root), load_pretrained().mean)

    # The drape that all others of a fabric are reached from

    def _references(self, tasks: Sequence[Task]) -> list[str]:
        """Dress the mean design on the mean body."""
        space = self.manifest.space
        mesh = reference_mesh(space, space.mean_design, self.config.reference_vertices).mesh
        cloth = build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, mesh.num_vertices)
        arrays = {"faces": mesh.faces, "start": placement(mesh)}
        subjects = [Subject(arrays, cloth, self.fabric(task.fabric)) for task in tasks]
        drapes = self.solver.dress(subjects, len(tasks) > 1)
        return [self._save_drape(*each) for each in zip(tasks, subjects, drapes, strict=True)]

    # Drapes on the mean body

    def _means(self, tasks: Sequence[Task]) -> list[str]:
        subjects = [self.subject(task.garment, task.fabric) for task in tasks]
        if self.config.convention == "dressed":
            drapes = self.solver.dress(subjects, len(tasks) > 1)
            return [self._save_drape(*each) for each in zip(tasks, subjects, drapes, strict=True)]
        starts = [self._mean_start(task, subject) for task, subject in zip(tasks, subjects, strict=True)]
        drapes = self.solver.relax(starts, [self.solver.mean_body] * len(tasks), subjects, len(tasks) > 1)
        return [self._save_drape(*each) for each in zip(tasks, subjects, drapes, strict=True)]

    def _mean_start(self, task: Task, subject: Subject) -> Start | None:
        first = self.manifest.first_topology(task.garment)
        if task.garment == first:
            reference = self._stored(reference_path(self.root, task.fabric))
            design = self.manifest.design(task.garment.rsplit("-", 1)[0])
            return reference and start_from_reference(self.manifest.space, self.guess, design, subject.mesh, reference)
        drape = self._stored(mean_path(self.root, first, task.fabric))
        return drape and start_from_mesh(subject.mesh, self.garment(first)[0], drape)

    # Rays

    def _rays(self, tasks: Sequence[Task]) -> list[str]:
        subjects = [self.subject(task.garment, task.fabric) for task in tasks]
        shapes = [self._shapes(task) for task in tasks]
        drapes: list[list[Drape | None]] = [[None] * len(betas) for betas in shapes]
        first = [self._is_followed(task.garment) for task in tasks]
        followed = [k for k, own in enumerate(first) if own]
        stored = [self._stored(mean_path(self.root, tasks[k].garment, tasks[k].fabric)) for k in followed]
        for k, found in zip(followed, self.solver.sweep(stored, *_pick(followed, shapes, subjects)), strict=True):
            drapes[k] = found
        carried = [k for k, own in enumerate(first) if not own]
        rows = [(k, i) for k in carried for i in range(len(shapes[k]))]
        starts = [start for k in carried for start in self._ray_starts(tasks[k], subjects[k], len(shapes[k]))]
        found = self.solver.relax(
            starts, [shapes[k][i] for k, i in rows], [subjects[k] for k, _ in rows], len(tasks) > 1
        )
        for (k, i), drape in zip(rows, found, strict=True):
            drapes[k][i] = drape
        return [self._save_ray(*each) for each in zip(tasks, subjects, shapes, drapes, strict=True)]

    def _is_followed(self, garment: str) -> bool:
        """Whether a garment is followed along rays; else it starts at each body from the first topology's drape."""
        return self.config.convention == "dressed" or garment == self.manifest.first_topology(garment)

    def _shapes(self, task: Task) -> Float[np.ndarray, "N b"]:
        """The body shapes of a ray; test shapes only where there are tests of this garment."""
        ray, test = self.protocol.rays[task.number], self.protocol.test[task.number]
        return ray[~test] if task.training_only else ray

    def _ray_starts(self, task: Task, subject: Subject, count: int) -> list[Start | None]:
        """Where a later topology starts at each shape: at the first topology's drape."""
        first = self.manifest.first_topology(task.garment)
        path = ray_path(self.root, first, task.fabric, task.number)
        if not path.exists():
            raise FileNotFoundError(f"{task.garment} starts from the drapes of {first}, and {str(path)!r} is not there")
        ray = load_arrays(path)
        there = self.garment(first)[0]
        return [
            start_from_mesh(subject.mesh, there, Start(ray["vertices"][i], ray["slip"][i]))
            if np.isfinite(ray["residual"][i])
            else None
            for i in range(count)
        ]

    def _save_ray(
        self, task: Task, subject: Subject, betas: Float[np.ndarray, "N b"], drapes: Sequence[Drape | None]
    ) -> str:
        """Store a ray; where the simulation diverged, the row holds the start of the garment and is marked."""
        count = len(subject.mesh["start"])
        rows = [self._statistics(drape, subject) for drape in drapes]
        table = {key: np.array([row[key] for row in rows], np.float32) for key in STATISTICS}
        nowhere = subject.mesh["start"].astype(np.float32)
        vertices = np.stack([nowhere if drape is None else drape.vertices for drape in drapes])
        arrays = {"vertices": vertices, "betas": betas}
        arrays["test"] = np.zeros(len(betas), bool) if task.training_only else self.protocol.test[task.number]
        if self._is_followed(task.garment):
            arrays["slip"] = np.stack([_slip(drape, count) for drape in drapes])
        self._save(task, arrays | table)
        return f"{task.garment} {task.fabric} ray {task.number}: {_line(rows[-1])}"

    # Templates for R_mean

    def _templates(self, tasks: Sequence[Task]) -> list[str]:
        """The template's drape of each design on the mean body, averaged over the fabrics."""
        make = self._dense_template if self.config.dense_vertices else self._fitted_template
        lines = []
        for task in tasks:
            template, statistics = make(task.garment)
            design = self.manifest.design(task.garment.rsplit("-", 1)[0])
            stored = np.zeros((0, 3)) if template is None else template
            arrays = {"design": np.asarray(design.values, float), "template": stored}
            self._save(task, arrays | _scalars(statistics))
            lines.append(f"template {design}: {_line(statistics)}")
        return lines

    def _fitted_template(self, garment: str) -> tuple[np.ndarray | None, dict[str, float]]:
        """The template nearest to the stored drapes: the M̄ that the other networks start from is then unbiased.

        (Drapes of a denser mesh hang 4 to 10 mm elsewhere, which R_smooth would have to unlearn.)
        """
        mesh, _ = self.garment(garment)
        drapes = [load_arrays(mean_path(self.root, garment, fabric)) for fabric in self.config.fabrics]
        if not all(np.isfinite(drape["residual"]) for drape in drapes):
            return None, DIVERGED
        # Tight garments stay in: their drapes in knitted fabric are valid where the garment in woven fabric could not
        # be put on.
        statistics = {key: float(drapes[0][key]) for key in STATISTICS}
        average = np.mean([drape["vertices"] for drape in drapes], axis=0)
        return fit_template(mesh["template_vertices"], mesh["template_weights"], average), statistics

    def _dense_template(self, garment: str) -> tuple[np.ndarray | None, dict[str, float]]:
        """The drape of the dense mesh in the first fabric, downsampled (the paper's way)."""
        design = self.manifest.design(garment.rsplit("-", 1)[0])
        dense = dense_template(self.manifest.space, design, self.config.dense_vertices)
        mesh = dense.mesh
        cloth = build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, mesh.num_vertices)
        arrays = {"faces": mesh.faces, "start": placement(mesh)}
        subject = Subject(arrays, cloth, self.fabric(self.config.fabrics[0]))
        (drape,) = self.solver.dress([subject], together=False)
        return None if drape is None else dense.downsample(drape.vertices), self._statistics(drape, subject)

    # Files

    def _stored(self, path: Path) -> Start | None:
        """A stored drape on the mean body, or None where it diverged."""
        if not path.exists():
            raise FileNotFoundError(f"{str(path)!r} is not there: drapes that others start from are simulated first")
        arrays = load_arrays(path)
        return Start(arrays["vertices"], arrays["slip"]) if np.isfinite(arrays["residual"]) else None

    def _save_drape(self, task: Task, subject: Subject, drape: Drape | None) -> str:
        statistics = self._statistics(drape, subject)
        start = subject.mesh["start"].astype(np.float32)
        vertices = start if drape is None else drape.vertices
        self._save(task, {"vertices": vertices, "slip": _slip(drape, len(start))} | _scalars(statistics))
        return f"{task.garment or 'mean design'} {task.fabric}: {_line(statistics)}"

    def _statistics(self, drape: Drape | None, subject: Subject) -> dict[str, float]:
        if drape is None:
            return DIVERGED
        return self.inspector.statistics(drape, subject.mesh["faces"], subject.cloth, subject.fabric)

    def _save(self, task: Task, arrays: dict[str, Any]) -> None:
        save_arrays(task.path(self.root), arrays | {"versions": _versions()})


def _pick(indices: Sequence[int], *lists: Sequence[Any]) -> list[list[Any]]:
    return [[values[k] for k in indices] for values in lists]


def _slip(drape: Drape | None, count: int) -> Float[np.ndarray, "V 3"]:
    return np.zeros((count, 3), np.float32) if drape is None else np.asarray(drape.state.slip)[:count]


def _scalars(statistics: dict[str, float]) -> dict[str, np.float32]:
    return {key: np.float32(statistics[key]) for key in STATISTICS}


def _versions() -> str:
    return json.dumps({name: version(name) for name in ("jax", "numpy", "scipy")})


def _line(statistics: dict[str, float]) -> str:
    if not np.isfinite(statistics["residual"]):
        return "diverged"
    return (
        f"residual {statistics['residual']:.3f}, depth {1e3 * statistics['depth']:+.1f} mm, "
        f"tension {statistics['tension']:.0f} N/m, self-intersecting {100 * statistics['self_intersections']:.2f} %"
    )
