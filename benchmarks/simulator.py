"""What a simulated drape costs: seconds per body shape, and per simulated second of two scenes.

python -m benchmarks simulator
python -m benchmarks simulator --batch 64     (on a GPU: many rays side by side)
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np

from benchmarks.record import write_record
from measuring.records import table
from measuring.textiles import lathe, plate, sample_fabric, settle, strip
from tryon_jax.body import load_body
from tryon_jax.garment import placement, remesh
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.physics.batch import sweep_many
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, dress, sweep
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.state import SolverSettings
from tryon_jax.training.protocol import RAY_LENGTH, make_protocol

Result = TypeVar("Result")
SCENES = {
    ("sheet", 1521): ("gray-interlock", "white-dots-on-blk"),
    ("sheet", 3481): ("white-dots-on-blk",),
    ("sphere", 1521): ("gray-interlock", "white-dots-on-blk"),
    ("sphere", 3481): ("white-dots-on-blk",),
}
"""A sheet of a metre that hangs by two corners, or falls on a sphere: vertices, and the fabrics that are timed."""


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks simulator`."""

    vertices: tuple[int, ...] = (1500, 3600)
    """Sizes of the garment, about."""
    design: str = "tshirt"
    """Design that is draped."""
    fabrics: tuple[str, ...] = ("gray-interlock", "white-dots-on-blk")
    rays: int = 2
    """Rays of body shapes that are timed, after one that warms up."""
    batch: int = 0
    """So many rays side by side instead, as on a GPU; 0: one after the other."""
    seconds: float = 1.0
    """Simulated seconds of the scenes."""
    scenes: bool = True
    """Time the scenes of cloth alone too."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def clock(call: Callable[[], Result]) -> tuple[float, float, Result]:
    """Wall-clock and processor seconds of a call, and its result."""
    wall, processor = time.perf_counter(), time.process_time()
    result = call()
    return time.perf_counter() - wall, time.process_time() - processor, result


@dataclass(frozen=True, eq=False)
class Garment:
    """A garment to be draped in one fabric."""

    start: np.ndarray
    cloth: Cloth
    fabric: Fabric


class SimulatorRun:
    """The body, the solver's settings and the rays that all rows share."""

    def __init__(self) -> None:
        self.obstacle, self.settings, self.equilibrium = Obstacle(load_body("female")), SolverSettings(), Equilibrium()
        self.protocol = make_protocol(2)

    def dress(self, garment: Garment) -> Drape:
        """A drape on the mean body."""
        how = self.obstacle, self.settings, self.equilibrium
        return dress(garment.start, garment.cloth, garment.fabric, *how)

    def rays(self, garment: Garment, first: Drape, numbers: list[int]) -> list[Drape]:
        """Drapes along rays, one after the other."""
        how = self.obstacle, self.settings, self.equilibrium
        rays = [self.protocol.rays[number] for number in numbers]
        return [drape for ray in rays for drape in sweep(first, ray, garment.cloth, garment.fabric, *how)]

    def side_by_side(self, garment: Garment, first: Drape, numbers: list[int], shapes: int = RAY_LENGTH) -> list[Drape]:
        """The same in lanes of one mapped solve, the first so many shapes of each ray."""
        how = self.obstacle, self.settings, self.equilibrium
        rays, count = np.stack([self.protocol.rays[number][:shapes] for number in numbers]), len(numbers)
        lanes = sweep_many([first] * count, rays, [garment.cloth] * count, [garment.fabric] * count, *how)
        return [drape for shapes in lanes for drape in shapes]


def shape_rows(config: Config) -> list[dict[str, Any]]:
    """Seconds per body shape along the protocol's rays, to equilibrium, without statistics and files."""
    manifest, run = load_manifest(), SimulatorRun()
    design, order = manifest.design(config.design), run.protocol.order
    # One mesh tells the garment's area.
    trial = remesh(manifest.space, design, manifest.target_area, seed=0)
    rows = []
    for size in config.vertices:
        mesh = remesh(manifest.space, design, manifest.target_area * trial.num_vertices / size, seed=0)
        cloth = build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, mesh.num_vertices)
        for name in config.fabrics:
            garment = Garment(placement(mesh), cloth, sample_fabric(name))
            first = run.dress(garment)
            row: dict[str, Any] = {"vertices": mesh.num_vertices, "fabric": name}
            row["dressing, s"] = clock(partial(run.dress, garment))[0]
            if config.batch:
                work = partial(run.side_by_side, garment, first, [order[k % len(order)] for k in range(config.batch)])
                work(shapes=1)
            else:
                work = partial(run.rays, garment, first, list(order[1 : config.rays + 1]))
                run.rays(garment, first, [order[0]])
            # What the first calls compiled is not timed.
            wall, processor, drapes = clock(work)
            count = len(drapes)
            row |= {"shapes": count, "s per shape": wall / count, "CPU s per shape": processor / count}
            row["steps per shape"] = float(np.mean([int(d.report.steps) for d in drapes]))
            row["at rest, %"] = 100 * float(np.mean([d.converged(run.equilibrium) for d in drapes]))
            rows.append(row)
    return rows


def scene_rows(config: Config) -> list[dict[str, Any]]:
    """CPU seconds for a simulated second of the scenes: with steps of 5 ms, and with the step that we use."""
    turn = np.linspace(0, np.pi, 41)
    ball = lathe(0.3 * np.stack([np.sin(turn), np.cos(turn)], axis=1))
    rows = []
    for (scene, vertices), fabrics in SCENES.items():
        cells = round(vertices**0.5) - 1
        faces, uv = strip(cells, cells, 1.0, 1.0)
        cloth = build_cloth(faces, uv, faces, len(uv))
        for name in fabrics:
            fabric = sample_fabric(name)
            height = 2.0 if scene == "sheet" else 0.3 + float(fabric.thickness)
            points = np.stack([uv[:, 0] - 0.5, np.full(len(uv), height), 0.5 - uv[:, 1]], axis=1)
            corners = np.array([0, len(uv) - cells - 1]) if scene == "sheet" else None
            surface = plate() if scene == "sheet" else ball
            for step in (1 / 200, 1 / 30):
                settings = SolverSettings(time_step=step, retention=1.0, max_move=0.1)
                run = partial(settle, faces, uv, points, fabric, surface, settings, pinned=corners, tolerance=0.0)
                run(most=20, cloth=cloth)
                _, processor, _ = clock(partial(run, most=round(config.seconds / step), cloth=cloth))
                row = {"scene": scene, "vertices": len(uv), "fabric": name, "time step, ms": 1e3 * step}
                row["CPU s per simulated s"] = processor / config.seconds
                rows.append(row)
    return rows


def main(config: Config) -> None:
    """Time both and keep the record."""
    shapes = shape_rows(config)
    print(table(shapes))
    scenes = scene_rows(config) if config.scenes else []
    if scenes:
        print("\n" + table(scenes))
    note = f"Load average at the end of this run: {os.getloadavg()[0]:.1f}."
    if config.save:
        print(f"\nwrote {write_record('simulator', config, [*shapes, *scenes], note=note)}")
