"""What a drape of `tryon catalogue` costs one core, with its guarantee and without: the basis of docs/cost.md.

python -m benchmarks catalogue
"""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.record import write_record
from measuring.records import table
from measuring.timing import milliseconds
from tryon_jax.commands._catalogue import Options, drape_block, make_catalogue, open_catalogue, open_session
from tryon_jax.commands._request import BodyShape, Cut, Request
from tryon_jax.garment import remesh
from tryon_jax.wear.prepared import prepared_design
from tryon_jax.wear.session import Session

VARIANTS = {"pushed out, measured and judged": {}, "draped alone": {"push_out": False, "fit": False, "gate": False}}
"""Options of each."""


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks catalogue`."""

    designs: tuple[str, ...] = ("tshirt", "dress", "tank", "sweater")
    """Presets."""
    bodies: int = Options.block
    """Bodies of a block, evenly along a diagonal of the betas."""
    repeats: int = 3
    """Timed calls of `prepare`."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def first_drape(session: Session, name: str) -> None:
    """All that a garment takes before its second body: pattern, mesh, graph, fields."""
    mesh = remesh(session.space, session.space.preset(name), session.triangle_area)
    session.drape(prepared_design(session.model, mesh))


def main(config: Config) -> None:
    """Drape each design on all bodies twice, the second time on the clock, and keep the table."""
    session = open_session("", None, config.bodies)
    garments = [Request(name, Cut(design=name)) for name in config.designs]
    share = [2 * k / max(config.bodies - 1, 1) - 1 for k in range(config.bodies)]
    bodies = [Request(f"{k:03d}", shape=BodyShape(betas=(2.0 * s, 1.3 * s))) for k, s in enumerate(share)]
    rows: dict[str, dict[str, Any]] = {}
    for name in config.designs:
        first_drape(session, name)  # compiles
        prepared = session.prepare(name)
        _, processor = milliseconds(lambda name=name: first_drape(session, name), config.repeats)
        rows[name] = {"garment": name, "vertices": len(prepared.garment.mean_vertices), "prepare, ms": processor}
    options = Options(fabric=session.fabrics[0], block=config.bodies)
    for variant, changes in VARIANTS.items():
        catalogue = make_catalogue(session, garments, bodies, replace(options, **changes))
        for timed in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                for task in open_catalogue(Path(folder), catalogue):
                    began = time.process_time()
                    drape_block(*task)
                    took = 1e3 * (time.process_time() - began) / config.bodies
                    row = rows[config.designs[task[1]]]
                    if timed:
                        row[f"{variant}, ms a drape"] = took
                        file = catalogue.table(Path(folder), task[1], task[2]).with_suffix(".npz")
                        row["file, bytes a drape"] = file.stat().st_size / config.bodies
    found = list(rows.values())
    print(table(found))
    if config.save:
        note = "processor time of one core; garment and bodies made before, as for all but the first of a block"
        print(f"wrote {write_record('catalogue', config, found, note=note)}")
