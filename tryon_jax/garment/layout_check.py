"""Checks that a layout draws panels that can be cut and sewn, over its whole range of parameters."""

import itertools
from collections.abc import Mapping

import numpy as np

from tryon_jax.garment import curves
from tryon_jax.garment.layout import Layout

SEAM_TOLERANCE = 0.005
"""Largest difference between the lengths of the two edges of a seam, as a fraction."""


MAX_COMBINATIONS = 243
"""Combinations of parameter values that are drawn at most, beside one parameter at a time."""


def check_layout(layout: Layout) -> None:
    """Check the geometry of a layout over its range of parameters.

    Drawn are all combinations of minimum, mean and maximum of the parameters that are active by default (of the first
    few, should there be more than five), and each other parameter at its minimum and maximum by itself.

    Raises:
        ValueError: from `check_drawing`, with the parameter values at which the layout fails.
    """
    means = {p.name: p.mean for p in layout.parameters}
    active = [p for p in layout.parameters if p.active]
    combined = active[: int(np.log(MAX_COMBINATIONS) / np.log(3) + 1e-9)]
    for values in itertools.product(*((p.mean, p.minimum, p.maximum) for p in combined)):
        check_drawing(layout, means | {p.name: v for p, v in zip(combined, values, strict=True)})
    for parameter in layout.parameters:
        if parameter not in combined:
            check_drawing(layout, means | {parameter.name: parameter.minimum})
            check_drawing(layout, means | {parameter.name: parameter.maximum})


def check_drawing(layout: Layout, values: Mapping[str, float]) -> None:
    """Check one drawing: outlines closed, counter-clockwise and simple, edges not too short, seams of equal length.

    Raises:
        ValueError: naming the panel, edge or seam, and the parameter values.
    """
    at = ", ".join(f"{k} = {v:g}" for k, v in values.items())
    drawn = layout.draw(values)
    for panel in layout.panels:
        where = f"{layout.source}: panel {panel.name!r}"
        ends = [drawn[e][[0, -1]] if forward else drawn[e][[-1, 0]] for e, forward in panel.outline]
        for i, (edge, _) in enumerate(panel.outline):
            following = panel.outline[(i + 1) % len(ends)][0]
            gap = float(np.linalg.norm(ends[i][1] - ends[(i + 1) % len(ends)][0]))
            if gap > 1e-6:
                raise ValueError(f"{where}: edge {edge!r} ends {gap:.4f} m from the start of {following!r} ({at})")
            if curves.length(drawn[edge]) < 0.01:
                raise ValueError(f"{where}: edge {edge!r} is shorter than 1 cm ({at})")
        lines = {
            e: curves.resample_polyline(drawn[e], max(2, int(curves.length(drawn[e]) / 0.01))) for e, _ in panel.outline
        }
        outline = layout.panel_outline(panel, lines)
        crossing = curves.first_crossing(outline)
        if crossing is not None:
            u, v = outline[crossing[0]]
            raise ValueError(f"{where}: the outline crosses itself near u = {u:.3f}, v = {v:.3f} ({at})")
        if curves.polygon_area(outline) <= 0:
            raise ValueError(f"{where}: the outline runs clockwise; walk its edges counter-clockwise ({at})")
    for seam, (first, second) in layout.seams.items():
        lengths = [curves.length(drawn[edge]) for _, edge in (first, second)]
        if abs(lengths[0] - lengths[1]) > SEAM_TOLERANCE * max(lengths):
            raise ValueError(
                f"{layout.source}: the two edges of seam {seam!r} do not match: {'.'.join(first)} is "
                f"{lengths[0]:.4f} m long, {'.'.join(second)} is {lengths[1]:.4f} m ({at})"
            )
