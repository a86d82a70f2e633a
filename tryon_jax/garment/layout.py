"""A sewing pattern as data: named points, edges, panels, seams and loops.

A layout knows nothing about meshes. Given the values of its parameters it draws its edges, each a dense polyline in
metres, and says which edges bound a panel, which are sewn together and which stay open.
"""

import ast
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice
from tryon_jax.garment import curves
from tryon_jax.garment.expressions import evaluate

MIRROR = np.array([-1.0, 1.0])


@dataclass(frozen=True)
class Parameter:
    """One design parameter of a layout: its range in metres and what it measures."""

    name: str
    minimum: float
    mean: float
    maximum: float
    meaning: str = ""
    active: bool = True
    """False for parameters that stay at their mean unless a design space asks for them."""


@dataclass(frozen=True)
class Edge:
    """One drawn edge: Bézier segments through named points, or the mirror image of another edge."""

    name: str
    path: tuple[tuple[str, ...], ...] = ()
    mirror_of: str | None = None
    symmetric: bool = False


@dataclass(frozen=True)
class Panel:
    """One piece of fabric: its edges in counter-clockwise order, and the side of the body it covers."""

    name: str
    side: str
    outline: tuple[tuple[str, bool], ...]
    """(edge, forward): forward is False where the outline walks the edge against its drawing."""


EdgeOfPanel = tuple[str, str]
"""(panel, edge)."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A parametric pattern; `load_layout` reads one from a file and checks it."""

    name: str
    parameters: tuple[Parameter, ...]
    presets: Mapping[str, Mapping[str, float]]
    measures: tuple[tuple[str, ast.expr], ...]
    points: tuple[tuple[str, ast.expr, ast.expr], ...]
    edges: Mapping[str, Edge]
    panels: tuple[Panel, ...]
    seams: Mapping[str, tuple[EdgeOfPanel, EdgeOfPanel]]
    loops: Mapping[str, tuple[EdgeOfPanel, ...]]
    source: str
    """Where the layout was read from, for messages."""
    builtin: bool = False
    """True for a layout that comes with the library."""

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name."""
        check_choice("parameter", name, [p.name for p in self.parameters])
        return next(p for p in self.parameters if p.name == name)

    def named_points(self, values: Mapping[str, float]) -> dict[str, Float[np.ndarray, " 2"]]:
        """Every named point for parameter values (all parameters, metres)."""
        names = dict(values)
        for measure, expression in self.measures:
            names[measure] = evaluate(expression, names, f"{self.source}: measure {measure!r}")
        points = {}
        for point, along_u, along_v in self.points:
            where = f"{self.source}: point {point!r}"
            names[point + "_x"] = evaluate(along_u, names, where)
            names[point + "_y"] = evaluate(along_v, names, where)
            points[point] = np.array([names[point + "_x"], names[point + "_y"]])
        return points

    def draw(self, values: Mapping[str, float]) -> dict[str, Float[np.ndarray, "_ 2"]]:
        """Every edge as a dense polyline [N, 2] in metres, in the direction of its drawing."""
        points = self.named_points(values)
        drawn: dict[str, np.ndarray] = {}
        for edge in self.edges.values():
            if edge.mirror_of is not None:
                drawn[edge.name] = drawn[edge.mirror_of] * MIRROR
                continue
            parts = [curves.sample_segment(kind, np.stack([points[n] for n in names])) for kind, *names in edge.path]
            line = curves.join_polylines(parts)
            if edge.symmetric:
                line = curves.join_polylines([line, line[::-1] * MIRROR])
            drawn[edge.name] = line
        return drawn

    def panel_outline(self, panel: Panel, drawn: Mapping[str, np.ndarray]) -> Float[np.ndarray, "N 2"]:
        """The closed outline of a panel, counter-clockwise, without repeating the first point."""
        lines = [drawn[edge] if forward else drawn[edge][::-1] for edge, forward in panel.outline]
        return curves.join_polylines(lines)[:-1]
