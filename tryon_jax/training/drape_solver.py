"""Simulating several garments: one by one on a CPU, or side by side in the size buckets of their cloths."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tryon_jax.physics.batch import dress_many, relax_many, sweep_many
from tryon_jax.physics.cloth import Cloth
from tryon_jax.physics.dressing import Diverged, Drape, Equilibrium, Obstacle, dress, relax, sweep, until_diverged
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.state import SolverSettings
from tryon_jax.training.reference import Start


class Subject(NamedTuple):
    """A garment in a fabric, ready to be simulated."""

    mesh: dict[str, np.ndarray]
    """As it is stored: faces, uv, faces_uv, template map, design, start."""
    cloth: Cloth
    fabric: Fabric


class DrapeSolver:
    """Simulates garments on one body; a drape is None where its simulation diverged."""

    def __init__(self, obstacle: Obstacle, num_betas: int) -> None:
        self.obstacle, self.mean_body = obstacle, np.zeros(num_betas)
        self.settings, self.equilibrium = SolverSettings(), Equilibrium()

    def dress(self, subjects: Sequence[Subject], together: bool) -> list[Drape | None]:
        """Put each on the mean body, from where its pattern is placed.

        Args:
            subjects: What to dress.
            together: Side by side; one by one otherwise.
        """
        body, settings, equilibrium = self.obstacle, self.settings, self.equilibrium
        betas = tuple(self.mean_body)

        def one(s: Subject) -> Drape:
            return dress(s.mesh["start"], s.cloth, s.fabric, body, settings, equilibrium, betas)

        def many(group: Sequence[Subject]) -> list[Drape]:
            starts = [s.mesh["start"] for s in group]
            return dress_many(starts, *_cloths(group), body, settings, equilibrium, betas)

        return _simulate(one, many, subjects, subjects, together)

    def relax(
        self,
        starts: Sequence[Start | None],
        betas: Sequence[Float[np.ndarray, " b"]],
        subjects: Sequence[Subject],
        together: bool,
    ) -> list[Drape | None]:
        """Let each come to rest on a body from a drape that is near; None where there is none to start from.

        Args:
            starts: Where each starts.
            betas: Body shape of each.
            subjects: What to relax.
            together: Side by side; one by one otherwise.
        """
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

    def sweep(
        self,
        starts: Sequence[Start | None],
        shapes: Sequence[Float[np.ndarray, "N b"]],
        subjects: Sequence[Subject],
    ) -> list[list[Drape | None]]:
        """Follow rays from drapes at rest on the mean body; nothing comes after a drape that diverged.

        Args:
            starts: Drape of each on the mean body.
            shapes: Body shapes along the ray of each.
            subjects: What to follow; several are followed side by side.
        """
        body, settings, equilibrium = self.obstacle, self.settings, self.equilibrium
        # A drape at rest stays where it is: no step is taken.
        at_rest = [
            None if start is None else relax(*start, self.mean_body, *s[1:], body, settings, equilibrium, max_steps=0)
            for start, s in zip(starts, subjects, strict=True)
        ]
        found: list[list[Drape | None]] = [[None] * len(betas) for betas in shapes]
        begun = [k for k, drape in enumerate(at_rest) if drape is not None]
        if len(subjects) == 1:
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
