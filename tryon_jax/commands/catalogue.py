"""Drape a catalogue: every garment of one CSV file on every body of another, on all cores or a cluster; resumable.

tryon catalogue --garments designs.csv --bodies bodies.csv --out drapes
tryon catalogue --garments designs.csv --bodies bodies.csv --out drapes --scheduler tcp://host:8786
"""

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from tryon_jax.checks import check_file, check_range
from tryon_jax.commands._catalogue import (
    Options,
    drape_block,
    join_tables,
    make_catalogue,
    open_catalogue,
    open_session,
)
from tryon_jax.commands._request import BODY_COLUMNS, GARMENT_COLUMNS, Request, read_requests
from tryon_jax.commands._say import say
from tryon_jax.commands._table import FAILED, TABLE
from tryon_jax.files.atomic import check_target
from tryon_jax.files.pool import available_cores, open_pool, run_all


@dataclass(frozen=True)
class Config:
    """Options of `tryon catalogue`."""

    garments: Path
    """CSV file with one garment per row: `name`, `fabric`, and the options of a design, or `garment` for a mesh."""
    bodies: Path
    """CSV file with one body per row: `name`, and `betas` or measurements in metres."""
    out: Path
    """Folder of the results: `fit.csv`, and a folder for each garment."""
    format: Literal["npz", "glb"] = "npz"
    """npz: a file of many drapes, positions of half the size; glb: a file for each garment on each body."""
    body_mesh: bool = False
    """Write the body into each GLB file too."""
    fabric: str | None = None
    """Fabric of the garments whose row names none, such as gray-interlock; the model's first when not given."""
    push_out: bool = True
    """Push cloth that lies inside the body out of it, by the least displacement, checked by exact distances."""
    fit: bool = True
    """Measure and judge every drape; --no-fit is faster, and nothing is refused."""
    gate: bool = True
    """Leave out drapes that are torn or lie in the body; with --no-gate they are written, and the table says it."""
    block: int = Options.block
    """Bodies that are draped at once and share a file; up to 128 are kept for the next garment (7 MB each)."""
    seed: int = 0
    """Another seed gives other meshes of the same garments."""
    triangle_area: float | None = None
    """Mean area of the cloth's triangles, square centimetres; what the networks were trained on when not given."""
    weights: Path | None = None
    """File of learned parameters in place of those that come with the package."""
    processes: int = field(default_factory=available_cores)
    """Worker processes, one core each; all cores when not given."""
    scheduler: str = ""
    """Address of a Dask scheduler, such as tcp://host:8786, whose workers do the work instead (extra `distributed`);
    they must see the folder, the meshes and the weights at the same paths."""


def main(config: Config) -> None:
    """Check every row, drape what is missing, and write the table of all fits."""
    check_range("--processes", config.processes, 1, 1024)
    check_range("--block", config.block, 1, 4096, "bodies")
    if config.triangle_area is not None:
        check_range("--triangle-area", config.triangle_area, 0.05, 100.0, "square centimetres")
    if config.body_mesh and config.format != "glb":
        raise ValueError("--body-mesh is for --format glb; NPZ files hold the betas of the bodies")
    if config.weights is not None:
        check_file("--weights", config.weights)
    root = config.out.expanduser().resolve()
    check_target(root / TABLE)
    garments, bodies = _read(config)
    weights = "" if config.weights is None else str(config.weights.expanduser().resolve())
    area = None if config.triangle_area is None else 1e-4 * config.triangle_area
    session = open_session(weights, area, config.block)
    options = Options(
        fabric=config.fabric or session.fabrics[0],
        weights=weights,
        triangle_area=area,
        seed=config.seed,
        push_out=config.push_out,
        fit=config.fit,
        gate=config.gate,
        format=config.format,
        body_mesh=config.body_mesh,
        block=config.block,
    )
    catalogue = make_catalogue(session, garments, bodies, options)
    missing = open_catalogue(root, catalogue)
    tasks = len(garments) * catalogue.blocks
    drapes = len(garments) * len(bodies)
    say(f"{len(garments)} garments × {len(bodies)} bodies; {tasks - len(missing)} of {tasks} blocks were done before")
    began, failed = time.monotonic(), []
    if missing:
        with open_pool(min(config.processes, len(missing)), config.scheduler) as pool:
            failed = run_all(pool, "drapes", drape_block, missing, tasks - len(missing))
    found = join_tables(root, catalogue)
    seconds = time.monotonic() - began
    counts = ", ".join(f"{number} {outcome}" for outcome, number in sorted(found.outcomes.items()))
    say(f"drapes   {counts}; {seconds:.1f} s, start of the workers and compilation included")
    if config.format == "npz":
        say(f"rounded  by {1e3 * found.rounding:.3f} mm at most")
    say(f"wrote    {root / TABLE}")
    lost = drapes - found.outcomes.total() + found.outcomes[FAILED]
    if lost:
        first = f", the first block: {failed[0]}" if failed else ""
        raise ValueError(f"{lost} of {drapes} drapes failed, see {TABLE}{first}; run again to try those again")


def _read(config: Config) -> tuple[list[Request], list[Request]]:
    """Rows of both files; what is wrong with either is said at once."""
    read, bad = [], []
    for path, columns in ((config.garments, GARMENT_COLUMNS), (config.bodies, BODY_COLUMNS)):
        try:
            # Workers may start in another folder.
            requests = read_requests(path, columns)
            read.append([replace(r, mesh=None if r.mesh is None else r.mesh.resolve()) for r in requests])
        except (ValueError, OSError) as error:
            bad.append(str(error))
    if bad:
        raise ValueError("; ".join(bad))
    return read[0], read[1]
