"""Patterns for paper: an SVG at scale 1:1 with cutting line, seam line, names, notches and grain line."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_range
from tryon_jax.files.atomic import write_text
from tryon_jax.garment import curves
from tryon_jax.garment.design import Design, DesignSpace
from tryon_jax.garment.layout import Panel

SEAM_ALLOWANCE = 0.010
"""Fabric outside the seam line where two edges are sewn together, metres."""

HEM_ALLOWANCE = 0.020
"""Fabric outside open edges that are turned up, metres; hollow ones such as necklines get the seam's."""

_MARGIN = 20.0
_GAP = 30.0
_STYLE = """
.cut { fill: none; stroke: #000; stroke-width: 0.5 }
.seam { fill: none; stroke: #000; stroke-width: 0.3; stroke-dasharray: 4 2 }
.mark { fill: none; stroke: #000; stroke-width: 0.3 }
text { font-family: sans-serif; font-size: 5px; text-anchor: middle }
.title { font-size: 9px; font-weight: bold }
""".strip()


def write_svg(
    path: str | Path,
    space: DesignSpace,
    design: Design,
    seam_allowance: float = SEAM_ALLOWANCE,
    hem_allowance: float = HEM_ALLOWANCE,
) -> None:
    """Write a design's panels as an SVG that prints at true size (1 unit = 1 mm).

    Each panel has its seam line (dashed), its cutting line outside it (solid), the names of its edges, notches at the
    middle of sewn edges, a grain line and its centre line, and its measures. Panels stand side by side; a 10 cm line
    checks the printer's scale.

    Args:
        path: the file; written whole or not at all.
        space: the design space.
        design: a design in it.
        seam_allowance: fabric outside sewn edges, metres.
        hem_allowance: fabric outside open edges, metres; edges that curve into the panel get `seam_allowance`.

    Raises:
        ValueError: for an allowance under 0 or over 5 cm.
    """
    write_text(path, pattern_svg(space, design, seam_allowance, hem_allowance))


def pattern_svg(
    space: DesignSpace,
    design: Design,
    seam_allowance: float = SEAM_ALLOWANCE,
    hem_allowance: float = HEM_ALLOWANCE,
) -> str:
    """The text of the SVG; see `write_svg`.

    Args:
        space: The design's space.
        design: The design.
        seam_allowance: Metres at seams.
        hem_allowance: Metres at hems and cuffs.
    """
    check_range("seam_allowance", seam_allowance, 0.0, 0.05, "m")
    check_range("hem_allowance", hem_allowance, 0.0, 0.05, "m")
    drawn = space.draw(design)
    layout = space.layout
    sewn = {member for seam in layout.seams.values() for member in seam}
    parts, left, bottom = [], _MARGIN, 0.0
    for panel in layout.panels:
        allowances = {}
        for edge, forward in panel.outline:
            turned_up = (panel.name, edge) not in sewn and not _hollow(drawn[edge] if forward else drawn[edge][::-1])
            allowances[edge] = hem_allowance if turned_up else seam_allowance
        cut = cutting_line(panel, drawn, allowances)
        low, high = cut.min(axis=0), cut.max(axis=0)
        offset = np.array([left - 1000 * low[0], _MARGIN + 1000 * high[1]])
        parts += _panel(panel, drawn, cut, offset, sewn)
        left += 1000 * (high[0] - low[0]) + _GAP
        bottom = max(bottom, _MARGIN + 1000 * (high[1] - low[1]))
    width, height = left - _GAP + _MARGIN, bottom + 40.0
    parts += [
        f'<path class="mark" d="M {_MARGIN} {height - 12} h 100 m 0 -2 v 4 m -100 0 v -4"/>',
        f'<text x="{_MARGIN + 50}" y="{height - 14}">10 cm: check the printed scale here</text>',
        f'<text x="{_MARGIN + 115}" y="{height - 10.5}" style="text-anchor: start">{_escape(_caption(design))}; '
        f"seam allowance {1000 * seam_allowance:g} mm, hems {1000 * hem_allowance:g} mm</text>",
    ]
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.2f}mm" height="{height:.2f}mm" '
        f'viewBox="0 0 {width:.2f} {height:.2f}">'
    )
    title = f"<title>{_escape(f'{layout.name}: {_caption(design)}')}</title>"
    return "\n".join([head, title, f"<style>{_STYLE}</style>", *parts, "</svg>"]) + "\n"


def cutting_line(
    panel: Panel, drawn: Mapping[str, Float[np.ndarray, "_ 2"]], allowances: Mapping[str, float]
) -> Float[np.ndarray, "M 2"]:
    """The outline of a panel moved outwards by each edge's allowance, counter-clockwise, metres.

    Neighbouring edges meet where their offset lines cross, as a cutter would draw them; a corner that would reach out
    further than twice the larger allowance is cut off.

    Args:
        panel: The panel.
        drawn: Polyline of each edge by name, metres.
        allowances: Metres by edge.
    """
    sides = []
    for edge, forward in panel.outline:
        line = drawn[edge] if forward else drawn[edge][::-1]
        sides.append(_offset(line, allowances[edge]))
    points = []
    for k, (edge, _) in enumerate(panel.outline):
        following = sides[(k + 1) % len(sides)]
        reach = 2 * max(allowances[edge], allowances[panel.outline[(k + 1) % len(sides)][0]], 1e-3)
        points.append(sides[k][1:-1] if len(sides[k]) > 2 else sides[k][:0])
        points.append(_corner(sides[k], following, reach))
    return _without_loops(np.concatenate(points))


def _offset(line: np.ndarray, distance: float) -> np.ndarray:
    """A polyline moved to the right of its direction (outside, for a counter-clockwise outline)."""
    along = np.diff(line, axis=0)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    at_points = np.concatenate([normal[:1], normal[:-1] + normal[1:], normal[-1:]])
    at_points /= np.linalg.norm(at_points, axis=1, keepdims=True)
    # Inside a curve the mitre lengthens the offset so that the moved segments keep their distance.
    towards = np.concatenate([normal[:1], normal])
    stretch = np.clip((at_points * towards).sum(axis=1), 0.5, 1.0)
    return line + distance * at_points / stretch[:, None]


def _hollow(line: np.ndarray) -> bool:
    """True for edges that curve into the panel, as necklines: they are bound or faced, for a hem would not lie flat."""
    return curves.length(_offset(line, HEM_ALLOWANCE)) < 0.95 * curves.length(line)


def _corner(line: np.ndarray, following: np.ndarray, reach: float) -> np.ndarray:
    """Where the end of one side and the start of the next meet: their crossing, or both ends when it is far off."""
    end, start = line[-1], following[0]
    u, v = line[-1] - line[-2], following[1] - following[0]
    cross = u[0] * v[1] - u[1] * v[0]
    if abs(cross) > 1e-9 * np.linalg.norm(u) * np.linalg.norm(v):
        gap = start - end
        meet = end + u * (gap[0] * v[1] - gap[1] * v[0]) / cross
        if max(np.linalg.norm(meet - end), np.linalg.norm(meet - start)) <= reach:
            return meet[None]
    return np.stack([end, start])


def _without_loops(points: np.ndarray) -> np.ndarray:
    """Cut away the small loops that an offset makes where an edge curves more sharply than the allowance."""
    for _ in range(50):
        crossing = curves.first_crossing(points)
        if crossing is None:
            break
        i, j = sorted(int(c) for c in crossing)
        a, b = points[i], points[i + 1]
        c, d = points[j], points[(j + 1) % len(points)]
        u, v, gap = b - a, d - c, c - a
        meet = a + u * (gap[0] * v[1] - gap[1] * v[0]) / (u[0] * v[1] - u[1] * v[0])
        if j - i <= len(points) // 2:
            points = np.concatenate([points[: i + 1], meet[None], points[j + 1 :]])
        else:
            points = np.concatenate([meet[None], points[i + 1 : j + 1]])
    return points


def _panel(
    panel: Panel, drawn: Mapping[str, np.ndarray], cut: np.ndarray, offset: np.ndarray, sewn: set[tuple[str, str]]
) -> list[str]:
    """Everything that is drawn of one panel; millimetres, y down."""

    def paper(points: np.ndarray) -> np.ndarray:
        return offset + 1000 * np.asarray(points) * np.array([1.0, -1.0])

    lines = [drawn[edge] if forward else drawn[edge][::-1] for edge, forward in panel.outline]
    seam = curves.join_polylines(lines)[:-1]
    parts = [
        f'<g id="{_escape(panel.name)}">',
        f'<path class="cut" d="{_path(paper(cut))}"/>',
        f'<path class="seam" d="{_path(paper(seam))}"/>',
    ]
    for (edge, _), line in zip(panel.outline, lines, strict=True):
        ends = curves.point_at(line, np.array([0.48, 0.5, 0.52]))
        along = (ends[2] - ends[0]) / np.linalg.norm(ends[2] - ends[0])
        inward = np.array([-along[1], along[0]])
        if (panel.name, edge) in sewn:
            notch = paper(np.stack([ends[1], ends[1] - 0.006 * inward]))
            parts.append(f'<path class="mark" d="{_path(notch, closed=False)}"/>')
        x, y = paper(ends[1] + 0.012 * inward)
        angle = -np.degrees(np.arctan2(along[1], along[0]))
        angle = (angle + 90) % 180 - 90
        label = f"{edge.replace('_', ' ')}, {100 * curves.length(line):.1f} cm"
        parts.append(f'<text transform="translate({x:.2f} {y:.2f}) rotate({angle:.1f})">{_escape(label)}</text>')
    low, high = seam.min(axis=0), seam.max(axis=0)
    x = 0.0 if low[0] < 0 < high[0] else (low[0] + high[0]) / 2
    top, bottom = paper(np.array([[x, high[1] - 0.28 * (high[1] - low[1])], [x, low[1] + 0.22 * (high[1] - low[1])]]))
    beside = f'style="text-anchor: start" x="{top[0] + 8:.2f}'
    parts += [
        f'<path class="mark" d="M {top[0]:.2f} {top[1]:.2f} V {bottom[1]:.2f} m -2 -5 l 2 5 l 2 -5 '
        f'M {top[0] - 2:.2f} {top[1] + 5:.2f} l 2 -5 l 2 5"/>',
        f'<text transform="translate({top[0] - 4:.2f} {(top[1] + bottom[1]) / 2:.2f}) rotate(-90)">'
        "grain line, centre</text>",
        f'<text class="title" {beside}" y="{top[1] + 20:.2f}">{_escape(panel.name)}</text>',
        f'<text {beside}" y="{top[1] + 28:.2f}">cut 1, drawn as seen from the front</text>',
        "</g>",
    ]
    return parts


def _path(points: np.ndarray, closed: bool = True) -> str:
    return "M " + " L ".join(f"{x:.2f} {y:.2f}" for x, y in points) + (" Z" if closed else "")


def _caption(design: Design) -> str:
    return (f"{design.label}: " if design.label else "") + ", ".join(
        f"{name.replace('_', ' ')} {100 * value:.1f} cm" for name, value in design.as_dict().items()
    )


def _escape(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")
