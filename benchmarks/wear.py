"""What the host does for one try-on: prepare, the body's surface, push-out, fit.

python -m benchmarks wear
python -m benchmarks wear --designs dress --repeats 15
"""

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.record import write_record
from measuring.records import table
from measuring.timing import milliseconds
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.tryon import prepare
from tryon_jax.wear.session import Session


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks wear`."""

    designs: tuple[str, ...] = ("tshirt", "dress", "tank")
    """Presets."""
    betas: tuple[float, ...] = (1.5, -0.5)
    """The body's shape."""
    repeats: int = 7
    """Timed calls of each step."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def main(config: Config) -> None:
    """Measure, print the table, and keep it."""
    session, rows = Session(), []
    for name in config.designs:
        draped = session.drape(session.prepare(name), config.betas)
        body, pushed = draped.body, session.push_out(draped)
        session.measure(pushed)
        moved = np.clip(session.space.preset(name).values + 0.01, session.space.minimum, session.space.maximum)
        to = session.space.from_values(moved)
        if session.prepare(to, near=draped.garment).near is None:
            raise ValueError(f"a design 1 cm from {name} was not near enough to keep its triangles")
        steps = {
            "prepare": lambda name=name: prepare(session.model, name),
            "prepare, design moved by 1 cm": lambda start=draped.garment, to=to: session.prepare(to, near=start),
            "surface of the body": lambda body=body: ClosedSurface(body.vertices, body.faces),
            "push out": lambda draped=draped: session.push_out(draped),
            "fit": lambda pushed=pushed: session.measure(replace(pushed, fit=None)),
        }
        for step, call in steps.items():
            wall, processor = milliseconds(call, config.repeats)
            row = {"design": name, "vertices": len(draped.vertices), "step": step}
            rows.append(row | {"wall, ms": wall, "processor, ms": processor})
    print(table(rows))
    if config.save:
        print(f"wrote {write_record('wear', config, rows, note='medians')}")
