"""What is said about a dressed body: in words, and as a record for JSON and CSV."""

from collections.abc import Sequence
from typing import Any

from tryon_jax.contact.push_out import PushedOut
from tryon_jax.wear.dressed import DressedBody


def report_lines(dressed: DressedBody, remarks: Sequence[str] = ()) -> list[str]:
    """The report in words, one line each; `remarks` are what there is to say about the body's shape."""
    garment, body = dressed.garment, dressed.body
    lines = [
        f"garment  {garment.label}; {len(dressed.vertices)} vertices, {len(garment.faces)} triangles",
        *(f"note     {repair}" for repair in garment.repairs),
        f"fabric   {dressed.fabric}",
        *remarks,
    ]
    if body.known_betas is not body.betas:
        shape = " ".join(f"{beta:+.2f}" for beta in body.known_betas)
        lines.append(f"note     draped on the networks' body of betas {shape}, carried to {body.body.name}")
    if dressed.arms:
        lines.append(f"stance   arms {dressed.arms:g} degrees below the horizontal; the fit is that of the T-pose")
    if dressed.simulated is not None:
        lines.append(f"solved   {dressed.simulated.words()}")
    if dressed.pushed is not None:
        lines.append(_push_line(dressed.pushed))
    lines += [] if dressed.fit is None else dressed.fit.lines()
    return lines if dressed.verdict is None else [*lines, *dressed.verdict.lines()]


def record(dressed: DressedBody, name: str) -> dict[str, Any]:
    """Everything of the report under the name of the request; lengths in metres."""
    design = dressed.garment.design
    return {
        "name": name,
        "garment": dressed.garment.label,
        "design": {} if design is None else design.as_dict(),
        "betas": [float(b) for b in dressed.body.betas],
        "fabric": dressed.fabric,
        **({"arms": dressed.arms} if dressed.arms else {}),
        "vertices": len(dressed.vertices),
        **({} if dressed.verdict is None else dressed.verdict.as_dict()),
        **({} if dressed.fit is None else dressed.fit.as_dict()),
        **({} if dressed.pushed is None else {"pushed": _pushed(dressed.pushed)}),
    }


def _pushed(pushed: PushedOut) -> dict[str, float]:
    """What the push out of the body found and did: a share, and metres."""
    return {
        "inside_before": pushed.inside_before,
        "deepest_before": pushed.deepest_before,
        "largest_move": pushed.largest_move,
    }


def _push_line(pushed: PushedOut) -> str:
    before = f"{100 * pushed.inside_before:.2f} % of the cloth lay up to {1e3 * pushed.deepest_before:.1f} mm inside"
    after = "none does now" if pushed.is_outside else f"{100 * pushed.inside:.2f} % still do"
    return f"pushed   {before}, {after}; largest move {1e3 * pushed.largest_move:.1f} mm"
