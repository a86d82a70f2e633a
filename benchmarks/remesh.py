"""Triangulation of garments: quality and time of what φ uses beside what it could use, and the cost of each step.

python -m benchmarks remesh
python -m benchmarks remesh --designs 1000 --methods forces
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

from benchmarks.record import write_record
from measuring.records import table
from tryon_jax.checks import check_choice
from tryon_jax.garment import (
    TARGET_AREA,
    Design,
    DesignSpace,
    build_template,
    dense_template,
    load_design_space,
    remesh,
)
from tryon_jax.garment.curves import inside_polygon, polygon_area
from tryon_jax.garment.sewing import edge_counts, sample_outline, sew
from tryon_jax.garment.triangulate import (
    delaunay_inside,
    edge_length,
    interior_count,
    panel_fault,
    relax,
    triangulate,
)
from tryon_jax.mesh.quality import measure_quality
from tryon_jax.mesh.topology import border_mask, unique_edges

Triangulate = Callable[[np.ndarray, int, np.random.Generator], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks remesh`."""

    designs: int = 40
    """Random designs on which quality is measured."""
    methods: tuple[str, ...] = ()
    """Methods to compare; all when not given."""
    target_area: float = TARGET_AREA
    """Mean triangle area, square metres."""
    repeats: int = 5
    """Timed calls of each step."""
    seed: int = 0
    """Seed of the random designs and of their meshes."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def throw_darts(outline: np.ndarray, spacing: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random points inside an outline, one after the other, none closer than 0.72 spacings to an earlier one."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    tries = rng.uniform(low, high, (int(12 * np.prod(high - low) / spacing**2), 2))
    tries = tries[inside_polygon(outline, tries)]
    tries = tries[cKDTree(outline).query(tries)[0] > 0.55 * spacing]
    near = cKDTree(tries).query_ball_point(tries, 0.72 * spacing)
    keep = np.ones(len(tries), bool)
    for k, others in enumerate(near):
        if keep[k]:
            keep[[o for o in others if o > k]] = False
    return tries[keep][:count]


def forces_from_darts(outline: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The forces of the library from a dart throw; where darts are too few the mesh is coarser than asked."""
    spacing = edge_length(polygon_area(outline) / max(len(outline) + 2 * count - 2, 1))
    return relax(outline, throw_darts(outline, spacing, count, rng), spacing, 40, refresh=10)


def optimal_delaunay(outline: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """12 steps to the area-weighted mean of the circumcentres around (Chen 2004, optimal Delaunay triangulation)."""
    points, faces = triangulate(outline, count, rng, iterations=1)
    for _ in range(12):
        a, b, c = (points[faces[:, k]] for k in range(3))
        u, v = b - a, c - a
        area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        uu, vv = (u * u).sum(axis=1), (v * v).sum(axis=1)
        centre = a + np.stack([v[:, 1] * uu - u[:, 1] * vv, u[:, 0] * vv - v[:, 0] * uu], axis=1) / (4 * area[:, None])
        # Circumcentres of obtuse triangles may lie far outside.
        middle = (a + b + c) / 3
        far = np.linalg.norm(centre - middle, axis=1) > 0.75 * np.sqrt(area.mean())
        centre[far] = middle[far]
        weight = np.bincount(faces.ravel(), np.repeat(area, 3), len(points))
        for k in range(2):
            moved = np.bincount(faces.ravel(), np.repeat(area * centre[:, k], 3), len(points)) / weight
            points[len(outline) :, k] = moved[len(outline) :]
        faces = delaunay_inside(points, len(outline))
    return points, faces


LONGEST = 1.49
"""Edges longer than this many spacings are split: mean areas then come out near the target."""
SHORTEST = 0.55
"""Edges shorter than this many spacings are collapsed."""


def local_operations(outline: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Split long edges, flip, collapse short ones, until none is left (Narain, Samii and O'Brien 2012, flat cloth).

    Flips are taken to their end at once, which is the Delaunay triangulation. Nothing fixes the number of triangles:
    `count` only sets the lengths. Seeds differ by where splits fall, up to a tenth of the edge off its middle.
    """
    fixed = len(outline)
    spacing = edge_length(polygon_area(outline) / max(fixed + 2 * count - 2, 1))
    points = outline.copy()
    for _ in range(40):
        faces = delaunay_inside(points, fixed)
        edges, uses = unique_edges(faces, len(points))
        edges = edges[uses == 2]
        length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        split = _undisturbed(edges, np.where(length > LONGEST * spacing, length, 0.0), len(points))
        if split.any():
            along = 0.5 + 0.1 * rng.uniform(-1, 1, (split.sum(), 1))
            middles = along * points[edges[split, 0]] + (1 - along) * points[edges[split, 1]]
            points = np.concatenate([points, middles])
            continue
        short = (length < SHORTEST * spacing) & (edges[:, 1] >= fixed)
        gone = edges[_undisturbed(edges, np.where(short, 1.0 / length, 0.0), len(points)), 1]
        if not len(gone):
            break
        points = np.delete(points, gone, axis=0)
    return points, delaunay_inside(points, fixed)


def _undisturbed(edges: np.ndarray, urgency: np.ndarray, count: int) -> np.ndarray:
    """Edges of positive urgency that are the most urgent ones at both of their ends."""
    most = np.zeros(count)
    for k in range(2):
        np.maximum.at(most, edges[:, k], urgency)
    return (urgency > 0) & (urgency == most[edges[:, 0]]) & (urgency == most[edges[:, 1]])


METHODS: dict[str, Triangulate] = {
    "forces": triangulate,
    "forces, 20 steps": partial(triangulate, iterations=20),
    "forces, 40 triangulations": partial(triangulate, refresh=1),
    "forces from a lattice": partial(triangulate, jitter=0.0),
    "forces from darts": forces_from_darts,
    "optimal Delaunay, 12 steps": optimal_delaunay,
    "local operations": local_operations,
}
"""What is compared; the first is what `remesh` uses."""


def cpu_ms(function: Callable[..., Any], *arguments: Any, repeats: int, **options: Any) -> float:
    """Median processor time of a call in milliseconds: the machine's other work counts less than by the clock."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function(*arguments, **options)
        times.append(1e3 * (time.process_time() - start))
    return float(np.median(times))


def panels(space: DesignSpace, design: Design, area: float) -> list:
    """Sampled outlines of a design."""
    drawn = space.draw(design)
    counts = edge_counts(space.layout, drawn, edge_length(area))
    return [sample_outline(panel, drawn, counts) for panel in space.layout.panels]


def compare(space: DesignSpace, name: str, config: Config) -> dict[str, Any]:
    """One row of the comparison: a method on the same random designs as the others."""
    method = METHODS[name]
    failures, shares, variations, angles, medians, worst, irregular = 0, [], [], [], [], [], []
    for k, design in enumerate(tqdm(space.sample(config.designs, config.seed), desc=name, leave=False)):
        rng = np.random.default_rng([config.seed, k])
        outlines = panels(space, design, config.target_area)
        made = [method(o.points, interior_count(o.points, config.target_area), rng) for o in outlines]
        points, faces = [p for p, _ in made], [f for _, f in made]
        try:
            mesh = sew(space.layout, design, outlines, points, faces)
        except ValueError:
            failures += 1
            continue
        failures += any(panel_fault(p, f, len(o.points)) != "" for o, p, f in zip(outlines, points, faces, strict=True))
        quality = measure_quality(mesh.uv, mesh.faces_uv)
        shares.append(quality.mean_area / config.target_area)
        variations.append(quality.area_variation)
        angles.append(quality.min_angle)
        medians.append(quality.median_angle)
        worst.append(quality.max_distortion)
        degree = np.bincount(unique_edges(mesh.faces, mesh.num_vertices)[0].ravel(), minlength=mesh.num_vertices)
        irregular.append((degree[~border_mask(mesh.faces, mesh.num_vertices)] != 6).mean())
    times = []
    for label in ("tank", "maxi-dress"):
        outlines = panels(space, space.preset(label), config.target_area)

        def both(outlines: list = outlines) -> None:
            for o in outlines:
                method(o.points, interior_count(o.points, config.target_area), np.random.default_rng(0))

        times.append(cpu_ms(both, repeats=config.repeats))
    return {
        "method": name,
        "failures": f"{failures} of {config.designs}",
        "mean area / T": f"{min(shares):.4f} to {max(shares):.4f}",
        "area variation": round(float(np.mean(variations)), 3),
        "smallest angle": round(min(angles), 1),
        "its median": round(float(np.median(angles)), 1),
        "median angle": round(float(np.mean(medians)), 1),
        "worst distortion": round(max(worst), 2),
        "irregular": f"{100 * np.mean(irregular):.0f} %",
        "tank, ms": round(times[0]),
        "maxi-dress, ms": round(times[1]),
    }


def steps(space: DesignSpace, config: Config) -> list[dict[str, Any]]:
    """Processor time of the steps from a design to a garment, for the smallest and the largest preset."""
    rows = []
    for label in ("tank", "tshirt", "maxi-dress"):
        design = space.preset(label)
        garment = remesh(space, design, config.target_area)
        row = {"design": label, "vertices": garment.num_vertices}
        row["template, ms"] = round(cpu_ms(build_template, space, design, repeats=config.repeats))
        row["remesh, ms"] = round(cpu_ms(remesh, space, design, config.target_area, repeats=config.repeats))
        dense_template(space, design)
        row["dense template, ms"] = round(cpu_ms(dense_template, space, design, repeats=2))
        rows.append(row)
    return rows


def main(config: Config) -> None:
    """Measure, print the two tables, and keep them."""
    names = [check_choice("method", name, METHODS) for name in config.methods] or list(METHODS)
    space = load_design_space()
    comparison = [compare(space, name, config) for name in names]
    print(table(comparison))
    cost = steps(space, config)
    print()
    print(table(cost))
    if config.save:
        note = (
            "times are processor time of one core; quality is measured over random designs of the whole space, "
            "front and back together; irregular: inner vertices without six neighbours"
        )
        print(f"wrote {write_record('remesh', config, comparison + cost, note=note)}")
