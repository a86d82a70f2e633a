"""Doing the tasks of the dataset: from the pattern to files of drapes (see `reference` for where each drape starts).

Tasks of one kind are done together: one by one on a CPU, side by side where several are handed over at once.
"""

import functools
import json
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tryon_jax.body import load_body
from tryon_jax.garment import dense_template, placement, remesh
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.nets.mlp import MeanDrape
from tryon_jax.physics.batch import dress_many, relax_many, sweep_many
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.dressing import Diverged, Drape, Equilibrium, Obstacle, dress, relax, sweep, until_diverged
from tryon_jax.physics.fabrics import Fabric, load_fabric
from tryon_jax.physics.state import SolverSettings
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
from tryon_jax.training.inspect import Inspector
from tryon_jax.training.plan import Task
from tryon_jax.training.protocol import Protocol, make_protocol
from tryon_jax.training.reference import Start, reference_mesh, start_from_mesh, start_from_reference, store_guess
from tryon_jax.tryon import load_pretrained

TEMPLATE_PULL = 0.02
"""Weight of the pull in `fit_template`, in garment vertices."""
DIVERGED: dict[str, float] = {key: float("inf") for key in STATISTICS}
"""Statistics of a drape whose simulation diverged: stored and excluded by every rule, never left out."""


class Subject(NamedTuple):
    """A garment in a fabric, ready to be simulated."""

    mesh: dict[str, np.ndarray]
    """As it is stored: faces, uv, faces_uv, template map, design, start."""
    cloth: Cloth
    fabric: Fabric


class Simulator:
    """What a worker process keeps between tasks: body, manifest, fabrics and the last garments."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.config = read_config(root)
        self.manifest = load_manifest()
        self.protocol: Protocol = make_protocol(self.config.num_betas)
        self.obstacle = Obstacle(load_body(self.config.body))
        self.inspector = Inspector(self.obstacle)
        self.settings, self.equilibrium = SolverSettings(), Equilibrium()
        self.mean_body = np.zeros(self.config.num_betas)
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
        drapes = self._dress(subjects, len(tasks) > 1)
        return [self._save_drape(*each) for each in zip(tasks, subjects, drapes, strict=True)]

    # Drapes on the mean body

    def _means(self, tasks: Sequence[Task]) -> list[str]:
        subjects = [self.subject(task.garment, task.fabric) for task in tasks]
        if self.config.convention == "dressed":
            drapes = self._dress(subjects, len(tasks) > 1)
            return [self._save_drape(*each) for each in zip(tasks, subjects, drapes, strict=True)]
        starts = [self._mean_start(task, subject) for task, subject in zip(tasks, subjects, strict=True)]
        drapes = self._relax(starts, [self.mean_body] * len(tasks), subjects, len(tasks) > 1)
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
        for k, found in zip(followed, self._sweep(*_pick(followed, tasks, shapes, subjects)), strict=True):
            drapes[k] = found
        carried = [k for k, own in enumerate(first) if not own]
        rows = [(k, i) for k in carried for i in range(len(shapes[k]))]
        starts = [start for k in carried for start in self._ray_starts(tasks[k], subjects[k], len(shapes[k]))]
        found = self._relax(starts, [shapes[k][i] for k, i in rows], [subjects[k] for k, _ in rows], len(tasks) > 1)
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
        (drape,) = self._dress([subject], together=False)
        return None if drape is None else dense.downsample(drape.vertices), self._statistics(drape, subject)

    # The simulations themselves: one by one, or together, side by side. None: it diverged.

    def _dress(self, subjects: Sequence[Subject], together: bool) -> list[Drape | None]:
        body, settings, equilibrium = self.obstacle, self.settings, self.equilibrium
        betas = tuple(self.mean_body)

        def one(s: Subject) -> Drape:
            return dress(s.mesh["start"], s.cloth, s.fabric, body, settings, equilibrium, betas)

        def many(group: Sequence[Subject]) -> list[Drape]:
            starts = [s.mesh["start"] for s in group]
            return dress_many(starts, *_cloths(group), body, settings, equilibrium, betas)

        return _simulate(one, many, subjects, subjects, together)

    def _relax(
        self,
        starts: Sequence[Start | None],
        betas: Sequence[Float[np.ndarray, " b"]],
        subjects: Sequence[Subject],
        together: bool,
    ) -> list[Drape | None]:
        body, settings, equilibrium = self.obstacle, self.settings, self.equilibrium

        def one(job: tuple[Start, np.ndarray, Subject]) -> Drape:
            start, shape, s = job
            return relax(*start, shape, s.cloth, s.fabric, body, settings, equilibrium)

        def many(group: Sequence[tuple[Start, np.ndarray, Subject]]) -> list[Drape]:
            begin, shapes, chosen = zip(*group, strict=True)
            vertices, slips = zip(*begin, strict=True)
            return relax_many(vertices, slips, np.stack(shapes), *_cloths(chosen), body, settings, equilibrium)

        jobs = [(start, b, s) for start, b, s in zip(starts, betas, subjects, strict=True) if start is not None]
        found = iter(_simulate(one, many, jobs, [s for _, _, s in jobs], together))
        return [None if start is None else next(found) for start in starts]

    def _sweep(
        self, tasks: Sequence[Task], shapes: Sequence[Float[np.ndarray, "N b"]], subjects: Sequence[Subject]
    ) -> list[list[Drape | None]]:
        """Follow rays from the stored drapes on the mean body; nothing comes after a drape that diverged."""
        body, settings, equilibrium = self.obstacle, self.settings, self.equilibrium
        stored = [self._stored(mean_path(self.root, task.garment, task.fabric)) for task in tasks]
        # A drape at rest stays where it is: no step is taken.
        at_rest = [
            None if start is None else relax(*start, self.mean_body, *s[1:], body, settings, equilibrium, max_steps=0)
            for start, s in zip(stored, subjects, strict=True)
        ]
        found: list[list[Drape | None]] = [[None] * len(betas) for betas in shapes]
        begun = [k for k, drape in enumerate(at_rest) if drape is not None]
        if len(tasks) == 1:
            for k in begun:
                s = subjects[k]
                steps = sweep(at_rest[k], shapes[k], s.cloth, s.fabric, body, settings, equilibrium)  # pyright: ignore[reportArgumentType]
                for i, drape in enumerate(until_diverged(steps)):
                    found[k][i] = drape
            return found
        for group in _by_bucket([subjects[k].cloth for k in begun]):
            lanes = [begun[i] for i in group]
            # Rays of fewer shapes wait at their last one for the others.
            longest = max(len(shapes[k]) for k in lanes)
            padded = [np.pad(shapes[k], ((0, longest - len(shapes[k])), (0, 0)), mode="edge") for k in lanes]
            first = [drape for k in lanes if (drape := at_rest[k]) is not None]
            swept = sweep_many(
                first, np.stack(padded), *_cloths([subjects[k] for k in lanes]), body, settings, equilibrium
            )
            diverged: set[int] = set()
            for i, drapes in enumerate(swept):
                for k, drape in zip(lanes, drapes, strict=True):
                    diverged |= set() if np.isfinite(float(drape.report.residual)) else {k}
                    if k not in diverged and i < len(found[k]):
                        found[k][i] = drape
        return found

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


def fit_template(
    corners: Int[np.ndarray, "V 3"], weights: Float[np.ndarray, "V 3"], vertices: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "T 3"]:
    """The template whose interpolation W T̄ is nearest to a drape, in least squares.

    A weak pull towards local averages settles template vertices that few garment vertices see.

    Args:
        corners: Template vertices that each garment vertex lies between.
        weights: Its barycentric weights.
        vertices: The drape, metres.

    Returns:
        Template positions, metres.
    """
    size = int(corners.max()) + 1
    rows = np.repeat(np.arange(len(corners)), 3)
    interpolation = sp.csr_array((weights.ravel(), (rows, corners.ravel())), shape=(len(corners), size))
    seen = np.maximum(np.asarray(interpolation.sum(axis=0)), 1e-9)
    local = (interpolation.T @ vertices) / seen[:, None]
    system = (interpolation.T @ interpolation).toarray() + TEMPLATE_PULL * np.eye(size)
    return np.linalg.solve(system, interpolation.T @ vertices + TEMPLATE_PULL * local)


def _pick(indices: Sequence[int], *lists: Sequence[Any]) -> list[list[Any]]:
    return [[values[k] for k in indices] for values in lists]


def _cloths(subjects: Sequence[Subject]) -> tuple[list[Cloth], list[Fabric]]:
    return [s.cloth for s in subjects], [s.fabric for s in subjects]


def _by_bucket(cloths: Sequence[Cloth]) -> list[list[int]]:
    """Indices of the cloths of each padded size."""
    sizes = [cloth.vertex_areas.shape[0] for cloth in cloths]
    return [[k for k, other in enumerate(sizes) if other == size] for size in sorted(set(sizes))]


def _simulate(
    one: Callable[[Any], Drape],
    many: Callable[[Any], list[Drape]],
    jobs: Sequence[Any],
    subjects: Sequence[Subject],
    together: bool,
) -> list[Drape | None]:
    """Jobs one by one, or together in the size buckets of their cloths; None where a simulation diverged."""
    found: list[Drape | None] = [None] * len(jobs)
    if not together:
        for k, job in enumerate(jobs):
            try:
                found[k] = one(job)
            except Diverged:
                continue
        return found
    for group in _by_bucket([s.cloth for s in subjects]):
        for k, drape in zip(group, many([jobs[i] for i in group]), strict=True):
            found[k] = drape if np.isfinite(float(drape.report.residual)) else None
    return found


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
