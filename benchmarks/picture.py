"""What a picture costs: a draped garment to a PNG file, on the clock and in processor time.

python -m benchmarks picture
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.record import write_record
from measuring.records import table
from measuring.timing import milliseconds
from tryon_jax.render import render_picture
from tryon_jax.render.mannequin import mannequin_colors
from tryon_jax.wear.session import Session


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks picture`."""

    designs: tuple[str, ...] = ("tshirt", "dress")
    """Presets."""
    heights: tuple[int, ...] = (450, 900)
    """Pixels."""
    repeats: int = 5
    """Timed pictures of each line."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def main(config: Config) -> None:
    """Measure, print the table, and keep it."""
    session, rows = Session(), []
    with tempfile.TemporaryDirectory() as folder:
        for name in config.designs:
            dressed = session.try_on(name)
            body, garment = (dressed.body.vertices, dressed.body.faces), (dressed.vertices, dressed.faces)
            colors = mannequin_colors(dressed.body.body)
            for height in config.heights:
                for views in (("front",), ("front", "side", "back")):
                    path = Path(folder) / "picture.png"
                    wall, cpu = milliseconds(
                        lambda path=path, body=body, garment=garment, views=views, height=height, colors=colors: (
                            render_picture(path, body, garment, views=views, height=height, body_colors=colors)
                        ),
                        config.repeats,
                    )
                    rows.append(
                        {
                            "garment": name,
                            "vertices": len(dressed.vertices),
                            "views": len(views),
                            "height, pixels": height,
                            "wall, ms": wall,
                            "processor, ms": cpu,
                            "file, kB": path.stat().st_size / 1e3,
                        }
                    )
    print(table(rows))
    if config.save:
        print(f"wrote {write_record('picture', config, rows, note='medians')}")
