"""A sewing pattern as data: named points, edges, panels, seams and loops, read from a TOML file.

A layout knows nothing about meshes. Given the values of its parameters it draws its edges, each a dense polyline in
metres, and says which edges bound a panel, which are sewn together and which stay open.
"""

import ast
import functools
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice, check_file
from tryon_jax.garment import curves
from tryon_jax.garment.expressions import evaluate, parse_expression

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
    """A parametric pattern; `load_layout` reads and checks one."""

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


@functools.cache
def _builtin(name: str) -> Layout:
    file = resources.files("tryon_jax") / "data" / "layouts" / f"{name}.toml"
    layout = parse_layout(tomllib.loads(file.read_text(encoding="utf-8")), source=f"layout {name!r}")
    return replace(layout, builtin=True)


def builtin_layouts() -> list[str]:
    """Names of the layouts that come with the library."""
    folder = resources.files("tryon_jax") / "data" / "layouts"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))


def load_layout(layout: str | Path = "kimono") -> Layout:
    """Read a layout: the name of one that comes with the library, or the path of a TOML file.

    The layout is checked at every minimum, mean and maximum of its parameters (see `check_layout`).

    Raises:
        ValueError: what is wrong, with the name of the offending entry.
        FileNotFoundError: for a path that does not exist.
    """
    if isinstance(layout, str) and not layout.endswith(".toml"):
        return _builtin(check_choice("layout", layout, builtin_layouts()))
    file = check_file("layout", layout)
    try:
        data = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"layout {str(file)!r} is not a TOML file: {error}") from error
    from tryon_jax.garment.layout_check import check_layout

    parsed = parse_layout(data, source=f"layout {str(file)!r}")
    check_layout(parsed)
    return parsed


_TABLES = ("parameters", "presets", "measures", "points", "edges", "panels", "seams", "loops")


def parse_layout(data: Mapping[str, Any], source: str) -> Layout:
    """Make a `Layout` of a parsed TOML document; names must resolve, geometry is not looked at.

    Raises:
        ValueError: for unknown or missing entries, names that do not resolve, and expressions that are no arithmetic.
    """
    for key in data:
        check_choice(f"entry of {source}", key, ("name", *_TABLES))
    for key in ("parameters", "points", "edges", "panels", "seams", "loops"):
        if not isinstance(data.get(key), Mapping) or not data[key]:
            raise ValueError(f"{source}: the table [{key}] is missing or empty")
    parameters = tuple(_parameter(n, t, source) for n, t in data["parameters"].items())
    measures = tuple(
        (n, parse_expression(text, f"{source}: measure {n!r}")) for n, text in data.get("measures", {}).items()
    )
    points = tuple(_point(n, pair, source) for n, pair in data["points"].items())
    edges: dict[str, Edge] = {}
    for name, table in data["edges"].items():
        edges[name] = _edge(name, table, [p[0] for p in points], edges, source)
    panels = tuple(_panel(n, t, edges, source) for n, t in data["panels"].items())
    known = {(p.name, edge) for p in panels for edge, _ in p.outline}
    seams, loops = {}, {}
    used: dict[EdgeOfPanel, str] = {}
    for kind, table, target in (("seam", data["seams"], seams), ("loop", data["loops"], loops)):
        for name, members in table.items():
            if not isinstance(members, list) or (kind == "seam" and len(members) != 2):
                raise ValueError(f'{source}: {kind} {name!r} needs a list of{" two" * (kind == "seam")} "panel.edge"')
            pairs = tuple(_edge_of_panel(m, known, f"{kind} {name!r}", source) for m in members)
            for pair in pairs:
                if pair in used:
                    raise ValueError(
                        f"{source}: edge {'.'.join(pair)!r} is both in {used[pair]} and in {kind} {name!r}"
                    )
                used[pair] = f"{kind} {name!r}"
            target[name] = pairs
    loose = sorted(known - set(used))
    if loose:
        raise ValueError(f"{source}: edge {'.'.join(loose[0])!r} is neither sewn (seams) nor open (loops)")
    layout = Layout(
        str(data.get("name", "layout")), parameters, {}, measures, points, edges, panels, seams, loops, source
    )
    return replace(layout, presets={n: _preset(n, t, layout) for n, t in data.get("presets", {}).items()})


def _parameter(name: str, table: Any, source: str) -> Parameter:
    allowed = ("minimum", "mean", "maximum", "meaning", "active")
    if not isinstance(table, Mapping):
        raise ValueError(f"{source}: parameter {name!r} needs minimum, mean and maximum")
    for key in table:
        check_choice(f"entry of parameter {name!r} in {source}", key, allowed)
    missing = [k for k in allowed[:3] if not isinstance(table.get(k), (int, float))]
    if missing:
        raise ValueError(f"{source}: parameter {name!r} needs a number for {missing[0]}")
    parameter = Parameter(
        name, *(float(table[k]) for k in allowed[:3]), *(table[k] for k in ("meaning",) if k in table)
    )
    if not parameter.minimum < parameter.mean < parameter.maximum:
        raise ValueError(f"{source}: parameter {name!r} needs minimum < mean < maximum")
    return Parameter(
        name, parameter.minimum, parameter.mean, parameter.maximum, parameter.meaning, bool(table.get("active", True))
    )


def _point(name: str, pair: Any, source: str) -> tuple[str, ast.expr, ast.expr]:
    where = f"{source}: point {name!r}"
    if not isinstance(pair, list) or len(pair) != 2:
        raise ValueError(f"{where} needs two expressions, [u, v]")
    return name, parse_expression(pair[0], where), parse_expression(pair[1], where)


def _edge(name: str, table: Any, points: list[str], before: Mapping[str, Edge], source: str) -> Edge:
    where = f"{source}: edge {name!r}"
    for key in table:
        check_choice(f"entry of edge {name!r} in {source}", key, ("path", "mirror_of", "symmetric"))
    if ("path" in table) == ("mirror_of" in table):
        raise ValueError(f"{where} needs either a path or mirror_of")
    if "mirror_of" in table:
        if table["mirror_of"] not in before:
            raise ValueError(f"{where} mirrors {table['mirror_of']!r}, which is not drawn above it")
        return Edge(name, mirror_of=table["mirror_of"])
    path = []
    for segment in table["path"]:
        kind, *names = segment
        check_choice(f"segment of {where}", kind, curves.SEGMENT_POINTS)
        if len(names) != curves.SEGMENT_POINTS[kind]:
            raise ValueError(f"{where}: a {kind} needs {curves.SEGMENT_POINTS[kind]} points, got {len(names)}")
        for point in names:
            check_choice(f"point of {where}", point, points)
        if path and path[-1][-1] != names[0]:
            raise ValueError(f"{where}: a segment ends at {path[-1][-1]!r} and the next starts at {names[0]!r}")
        path.append((kind, *names))
    if not path:
        raise ValueError(f"{where} has an empty path")
    return Edge(name, tuple(path), symmetric=bool(table.get("symmetric", False)))


def _panel(name: str, table: Any, edges: Mapping[str, Edge], source: str) -> Panel:
    where = f"{source}: panel {name!r}"
    for key in table:
        check_choice(f"entry of panel {name!r} in {source}", key, ("side", "outline"))
    outline = []
    for entry in table.get("outline", []):
        edge = entry.removeprefix("-")
        check_choice(f"edge of {where}", edge, edges)
        outline.append((edge, not entry.startswith("-")))
    if len(outline) < 3 or len({e for e, _ in outline}) < len(outline):
        raise ValueError(f"{where} needs an outline of at least three different edges")
    return Panel(name, check_choice(f"side of {where}", table.get("side", ""), ("front", "back")), tuple(outline))


def _edge_of_panel(text: Any, known: set[EdgeOfPanel], what: str, source: str) -> EdgeOfPanel:
    panel, _, edge = str(text).partition(".")
    check_choice(f"edge of {what} in {source}", f"{panel}.{edge}", sorted(f"{p}.{e}" for p, e in known))
    return panel, edge


def _preset(name: str, table: Mapping[str, Any], layout: Layout) -> dict[str, float]:
    values = {}
    for key, value in table.items():
        parameter = layout.parameter(key)
        if not isinstance(value, (int, float)) or not parameter.minimum <= value <= parameter.maximum:
            raise ValueError(
                f"{layout.source}: preset {name!r} sets {key} = {value!r}, outside its range "
                f"{parameter.minimum:g} to {parameter.maximum:g} m"
            )
        values[key] = float(value)
    return values
