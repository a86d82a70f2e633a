"""The accuracy table of the results page: rows, aims, and the picture."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tryon_jax.files.atomic import atomic_path

ROWS = {
    "mean drape": "do nothing: M̄",
    "transfer": "M̄ moved with the nearest body vertex",
    "neighbours": "nearest training garments (kNN), no learning",
    "neighbours, design": "the same with the design in the key",
    "smooth, own target": "R_smooth against its own target, the smoothed simulation",
    "smooth": "R_smooth alone: M_smooth",
    "mean detail": "M_smooth + detail of M̄",
    "carried offset": "M_smooth + offset simulated on the mean body",
    "bare": "R_smooth and the R_fine of all fabrics, as for a mesh without a design",
    "kriging": "training drapes kriged over designs and body shapes, no networks",
    "pipeline": "full pipeline: M_fine",
    "refined": "full pipeline and a few steps of the solver (`tryon drape --refine`)",
    "paper form": "the same in the paper's form, betas at each node, trained for longer on the same data",
    "dressed": "full pipeline against drapes that were dressed by themselves",
    "dressed, simulation": "the simulation against drapes that were dressed by themselves",
    "spread": "simulator's spread between two meshes of a design: displacement",
    "spread, drape": "simulator's spread between two meshes of a design: drape",
    "simulation": "the simulation itself",
}
"""Rows of the table; "carried offset" alone needs a simulation of the garment, on the mean body."""
TWINS = "trained topologies of that design, same shapes"


def markdown(results: Mapping[str, Any]) -> list[str]:
    """The table of each case, fabrics side by side."""
    lines = []
    for case, rows in results["table"].items():
        if not rows:
            lines += [f"**{case}**: nothing simulated, not measured", ""]
            continue
        fabrics = list(next(iter(rows.values())))
        lines += [
            f"**{case}** ({results['garments'][case]} garments)",
            "",
            "| | "
            + " | ".join(f"{f}: mean · p95 · ends of the range, mm" for f in fabrics)
            + " | wrinkles ÷ simulated: total · varying (correlation) | inside the body, % |",
            "|---|" + "---|" * (len(fabrics) + 2),
        ]
        for row, title in ROWS.items():
            if row not in rows:
                continue
            cells = []
            for fabric in fabrics:
                entry = rows[row].get(fabric)
                values = [entry[k] for k in ("mean_mm", "p95_mm", "ends_mm")] if entry else [None] * 3
                cells.append(" · ".join(_number(v, 1 if k else 2) for k, v in enumerate(values)))
            averaged = {
                k: _average(rows[row], k)
                for k in ("wrinkles_total", "wrinkles_varying", "wrinkle_correlation", "inside_percent")
            }
            wrinkles = "–"
            if averaged["wrinkles_total"] is not None:
                total, varying = _number(averaged["wrinkles_total"]), _number(averaged["wrinkles_varying"])
                wrinkles = f"{total} · {varying} ({_number(averaged['wrinkle_correlation'])})"
            lines.append(f"| {title} | {' | '.join(cells)} | {wrinkles} | {_number(averaged['inside_percent'])} |")
        lines.append("")
    return [*lines, *aims(results)]


def aims(results: Mapping[str, Any]) -> list[str]:
    """Each aim beside what was measured; averages over the fabrics."""

    def value(case: str, row: str = "pipeline", key: str = "mean_mm") -> float | None:
        by_fabric = results["table"].get(case, {}).get(row)
        return None if by_fabric is None else _average(by_fabric, key)

    def over_neighbours(case: str) -> float | None:
        """Error over that of the better kNN."""
        known = [kin for row in ("neighbours", "neighbours, design") if (kin := value(case, row)) is not None]
        return _ratio(value(case), min(known)) if known else None

    trained, unseen = value("as trained"), value("unseen design")
    twins, topologies = value(TWINS), value("unseen topology")
    rows = [
        ("trained design and topology, mm", trained, 0.0, 2.0),
        ("unseen topology, mm", topologies, 0.0, 2.6),
        ("unseen topology ÷ trained ones of that design", _ratio(topologies, twins), 0.0, 1.05),
        ("unseen design, mm", unseen, 0.0, 3.0),
        ("trained ÷ the better kNN", over_neighbours("as trained"), 0.0, 1.0),
        ("unseen topology ÷ the better kNN", over_neighbours("unseen topology"), 0.0, 1.0),
        ("unseen design ÷ the better kNN", over_neighbours("unseen design"), 0.0, 0.8),
        ("unseen design ÷ kriging", _ratio(unseen, value("unseen design", "kriging")), 0.0, 1.0),
        ("ends of the range ÷ mean", _ratio(value("as trained", key="ends_mm"), trained), 0.0, 1.5),
        ("unseen design: varying folds, energy ÷ simulated", value("unseen design", key="wrinkles_varying"), 0.75, 1.1),
        ("unseen design: varying folds, correlation", value("unseen design", key="wrinkle_correlation"), 0.7, 1.0),
    ]
    lines = ["| aim | measured | wanted | |", "|---|---|---|---|"]
    for title, measured, low, high in rows:
        wanted = f"{low:g} to {high:g}" if low else f"at most {high:g}"
        word = "not measured" if measured is None else "reached" if low <= measured <= high else "not reached"
        lines.append(f"| {title} | {_number(measured)} | {wanted} | {word} |")
    return lines


def _ratio(part: float | None, whole: float | None) -> float | None:
    return None if part is None or not whole else part / whole


def _average(by_fabric: Mapping[str, Mapping[str, Any]], key: str) -> float | None:
    values = [entry[key] for entry in by_fabric.values() if entry.get(key) is not None]
    return float(np.mean(values)) if values else None


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def draw(path: Path, results: Mapping[str, Any]) -> None:
    """Bars of the mean distance by row and case."""
    from matplotlib.figure import Figure

    cases = [case for case, rows in results["table"].items() if rows]
    shown = [row for row in ROWS if row not in ("simulation", "smooth, own target")]
    figure = Figure(figsize=(9, 0.9 + 0.55 * len(shown)), dpi=90, layout="constrained")
    axis = figure.subplots()
    height = 0.8 / max(len(cases), 1)
    for number, case in enumerate(cases):
        rows = results["table"][case]
        values = [_average(rows[row], "mean_mm") if row in rows else None for row in shown]
        at = np.arange(len(shown)) + (number - (len(cases) - 1) / 2) * height
        bars = axis.barh(at, [v or 0.0 for v in values], 0.92 * height, label=case)
        axis.bar_label(bars, [_number(v, 1) for v in values], padding=3, fontsize=7)
    axis.set_yticks(np.arange(len(shown)), [ROWS[row] for row in shown], fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("mm from the simulation, test shapes")
    axis.legend(fontsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
