"""What a garment costs before its first drape: graph, pooling, smoothing; sizes, padding, and soundness of hierarchies.

python -m benchmarks prepare
python -m benchmarks prepare --designs 200
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import fast_simplification
import numpy as np
from tqdm import tqdm

from benchmarks._networks import PAPER_SIZES, random_model
from benchmarks.record import write_record
from measuring.records import table
from measuring.timing import milliseconds
from tryon_jax.garment import load_design_space, placement, remesh
from tryon_jax.graph import build_graph, padding_share
from tryon_jax.graph.build import closest_body_vertices
from tryon_jax.graph.coarsen import CoarseMesh, coarsen
from tryon_jax.graph.laplacian import scaled_laplacian
from tryon_jax.graph.pooling import down_matrix, up_matrix
from tryon_jax.graph.smoothing import make_smoother
from tryon_jax.mesh.quality import angles
from tryon_jax.mesh.topology import inspect_topology, unique_edges
from tryon_jax.nets import SMALL
from tryon_jax.tryon import prepare


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks prepare`."""

    designs: int = 200
    """Random designs for padding and for the soundness of hierarchies."""
    levels: int = 5
    """Halvings of a hierarchy."""
    repeats: int = 7
    """Timed calls of each step."""
    seed: int = 0
    """Seed of the random designs."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def hierarchy(
    vertices: np.ndarray, faces: np.ndarray, step: Callable[[np.ndarray, np.ndarray], CoarseMesh], levels: int
) -> list[tuple[np.ndarray, CoarseMesh]]:
    """Each level's vertices before and what the step made of them."""
    made = []
    for _ in range(levels):
        coarse = step(vertices, faces)
        made.append((vertices, coarse))
        vertices, faces = vertices[coarse.kept], coarse.faces
    return made


def by_fast_simplification(vertices: np.ndarray, faces: np.ndarray) -> CoarseMesh:
    """The library's collapses: half of the faces, kept vertices taken as the nearest of each cluster."""
    # Its thresholds are absolute: metres are too small for them.
    points, small = np.ascontiguousarray(100 * vertices), faces.astype(np.int32)
    _, _, collapses = fast_simplification.simplify(points, small, target_count=len(faces) // 2, return_collapses=True)
    new, triangles, cluster = fast_simplification.replay_simplification(points, small, collapses)
    distance = np.linalg.norm(points - new[cluster], axis=1)
    order = np.lexsort((distance, cluster))
    kept = order[np.unique(cluster[order], return_index=True)[1]]
    return CoarseMesh(triangles.astype(np.int64), kept, cluster.astype(np.int64))


def soundness(config: Config) -> list[dict[str, Any]]:
    """Hierarchies over random designs: topology, triangles, sizes, round trips."""
    space = load_design_space()
    meshes = []
    for design in tqdm(space.sample(config.designs, config.seed), desc="meshes", leave=False):
        mesh = remesh(space, design)
        meshes.append((placement(mesh), mesh.faces))
    shares = [padding_share(len(v)) for v, _ in meshes]
    rows = []
    for name, step in (("library", coarsen), ("fast-simplification", by_fast_simplification)):
        bad, ratios, worst, trips = 0, [], [], {"average": [], "select": []}
        for vertices, faces in tqdm(meshes, desc=name, leave=False):
            before = inspect_topology(faces, len(vertices))
            sound = True
            for fine, coarse in hierarchy(vertices, faces, step, config.levels):
                now = inspect_topology(coarse.faces, len(coarse.kept))
                same = (now.euler, now.loops, now.components) == (before.euler, before.loops, before.components)
                sound &= same and now.is_manifold
                ratios.append(len(coarse.kept) / len(fine))
                worst.append(float(np.degrees(angles(fine[coarse.kept], coarse.faces).min())))
            bad += not sound
            fine, coarse = vertices, step(vertices, faces)
            for pooling, values in trips.items():
                down = down_matrix(coarse, pooling)  # type: ignore[arg-type]
                up = up_matrix(fine, down @ fine, coarse.faces, coarse.cluster)
                values.append(1e3 * np.sqrt((np.linalg.norm(up @ (down @ fine) - fine, axis=1) ** 2).mean()))
        rows.append(
            {
                "hierarchy": name,
                "designs with a bad level": f"{bad} of {len(meshes)}",
                "vertex ratio": f"{min(ratios):.4f} to {max(ratios):.4f}",
                "smallest angle, degrees": min(worst),
                "round trip averaged, mm": float(np.mean(trips["average"])),
                "round trip selected, mm": float(np.mean(trips["select"])),
                "padding, mean": float(np.mean(shares)),
                "padding, largest": float(np.max(shares)),
            }
        )
    return rows


def steps(config: Config) -> list[dict[str, Any]]:
    """Times of the steps from a mesh to a garment that can be draped."""
    model, space, rows = random_model(SMALL), load_design_space(), []
    for size in PAPER_SIZES:
        design = space.preset("tank" if size < 2000 else "maxi-dress")
        area = SMALL.target_area
        mesh = remesh(space, design, area)
        if abs(mesh.num_vertices / size - 1) > 0.05:
            area *= mesh.num_vertices / size
            mesh = remesh(space, design, area)
        vertices, faces = placement(mesh), mesh.faces
        made = hierarchy(vertices, faces, coarsen, SMALL.num_levels - 1)
        meshes = [(vertices, faces)] + [(fine[c.kept], c.faces) for fine, c in made]

        def laplacians(meshes: list = meshes) -> None:
            for points, triangles in meshes:
                scaled_laplacian(unique_edges(triangles, len(points))[0], len(points))

        def pooling(made: list = made) -> None:
            for fine, coarse in made:
                down = down_matrix(coarse)
                up_matrix(fine, down @ fine, coarse.faces, coarse.cluster)

        parts: dict[str, Callable[[], Any]] = {
            "coarsen": lambda v=vertices, f=faces: hierarchy(v, f, coarsen, SMALL.num_levels - 1),
            "fast-simplification": lambda v=vertices, f=faces: hierarchy(
                v, f, by_fast_simplification, SMALL.num_levels - 1
            ),
            "Laplacians": laplacians,
            "down and up": pooling,
            "closest body vertices": lambda v=vertices: closest_body_vertices(v, model.body),
            "build_graph, all of these": lambda v=vertices, f=faces: build_graph(v, f, model.body),
            "smoother": lambda v=vertices, f=faces: make_smoother(v, f, SMALL.smoothing_length),
            "prepare, from design": lambda d=design, a=area: prepare(model, d, target_area=a),
        }
        for name, call in parts.items():
            wall, cpu = milliseconds(call, config.repeats)
            rows.append({"vertices": len(vertices), "step": name, "wall, ms": wall, "processor, ms": cpu})
    return rows


def main(config: Config) -> None:
    """Measure, print the tables, and keep them."""
    cost = steps(config)
    print(table(cost))
    sound = soundness(config)
    print(table(sound))
    if config.save:
        note = "medians; a bad level has other loops, components or Euler characteristic, or is not manifold"
        print(f"wrote {write_record('prepare', config, cost + sound, note=note)}")
