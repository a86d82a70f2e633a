"""Layouts in TOML files: reading them, and saying what is wrong with one."""

import ast
import functools
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from tryon_jax.checks import check_choice, check_file
from tryon_jax.garment import curves
from tryon_jax.garment.expressions import parse_expression
from tryon_jax.garment.layout import Edge, EdgeOfPanel, Layout, Panel, Parameter
from tryon_jax.garment.layout_check import check_layout


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
    minimum, mean, maximum = (float(table[k]) for k in allowed[:3])
    if not minimum < mean < maximum:
        raise ValueError(f"{source}: parameter {name!r} needs minimum < mean < maximum")
    return Parameter(name, minimum, mean, maximum, str(table.get("meaning", "")), bool(table.get("active", True)))


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
