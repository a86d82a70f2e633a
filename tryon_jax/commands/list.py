"""List what can be asked for: presets, design parameters, fabrics, bodies, measurements, pretrained models.

tryon list
"""

from dataclasses import dataclass

import numpy as np

from tryon_jax.body.embedded import NAMES
from tryon_jax.body.measurements import MEASUREMENTS
from tryon_jax.commands._say import say
from tryon_jax.garment import load_design_space
from tryon_jax.nets.config import load_config
from tryon_jax.physics.fabrics import GRID, GRID_LOW, fabric_names, load_fabric

_ZERO_STRAIN = round(-GRID_LOW * GRID)


@dataclass(frozen=True)
class Config:
    """Options of `tryon list`."""

    layout: str = "kimono"
    """Name of a layout, or the path of a layout file (.toml)."""


def main(config: Config) -> None:
    """Print the lists."""
    space = load_design_space(config.layout)
    learned = load_config("small")
    lines = ["presets  " + ", ".join(space.presets)]
    lines += [
        f"design   {name} {space.minimum[k]:.2f} to {space.maximum[k]:.2f} m, {space.layout.parameter(name).meaning}"
        for k, name in enumerate(space.names)
    ]
    lines += [f"fabric   {name}: {describe_fabric(name)}" for name in fabric_names()]
    lines.append("body     " + ", ".join(NAMES) + ", or a file of SMPL, SMPL-H or SMPL-X")
    ranges = ", ".join(f"beta {k + 1} to ±{reach:g}" for k, reach in enumerate(learned.beta_ranges))
    lines.append(f"betas    the weights know {ranges} standard deviations")
    lines += [
        f"measure  {name} {one.low:.2f} to {one.high:.2f} m, {one.standard}" for name, one in MEASUREMENTS.items()
    ]
    say(*lines)


def describe_fabric(name: str) -> str:
    """A fabric in plain words: how heavy it is, how far it gives and how softly it falls."""
    fabric = load_fabric(name)
    grams, bending = 1000 * float(fabric.density), float(np.mean(fabric.bending))
    # Stiffness along warp and weft at zero strain, N/m.
    pull = float(np.mean(np.asarray(fabric.stretch_table)[_ZERO_STRAIN, _ZERO_STRAIN, 0][[0, 2]]))
    weight = "light" if grams < 170 else "medium" if grams < 260 else "heavy"
    give = "stretchy" if pull < 110 else "firm"
    fall = "soft" if bending < 2.5e-5 else "stiff" if bending > 7e-5 else "medium soft"
    return f"{weight} ({grams:.0f} g/m²), {give}, {fall}"
