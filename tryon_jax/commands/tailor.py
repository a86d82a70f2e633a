"""A pattern made to measure: the design whose garment sits on a body as asked, and how it does.

tryon tailor --stature 1.72 --chest 0.96 --ease-chest 0.08 --hem 0.60 --design dress --out pattern.svg --picture fit.png
tryon tailor --betas 1 -0.5 --ease-chest 0.12 --refine --garment dress.glb
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

from tryon_jax.checks import check_choice, check_file
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._output import OutputOptions, Target
from tryon_jax.commands._report import record, report_lines
from tryon_jax.commands._request import BodyShape, Cut, resolve_betas, resolve_design
from tryon_jax.commands._say import say
from tryon_jax.files.atomic import check_target, together, write_text
from tryon_jax.garment.svg import HEM_ALLOWANCE, SEAM_ALLOWANCE, write_svg
from tryon_jax.tryon import load_model, load_pretrained
from tryon_jax.wear.fit import EASE_AT
from tryon_jax.wear.gate import judge_betas
from tryon_jax.wear.session import Session
from tryon_jax.wear.tailor import HEM, FitTarget, Tailored, tailor


@dataclass(frozen=True)
class Asked:
    """How the garment shall sit; what is not given stays as in the design."""

    ease_chest: float | None = None
    """Girth of the garment minus that of the body at the chest, metres."""
    ease_waist: float | None = None
    """The same at the waist."""
    ease_hip: float | None = None
    """The same at the hip."""
    hem: float | None = None
    """Height of the hem over the floor, metres."""

    def target(self) -> FitTarget:
        """All of it; raises `ValueError` for nothing at all and for values out of range."""
        given = {name: getattr(self, f"ease_{name}") for name in EASE_AT}
        return FitTarget({name: value for name, value in given.items() if value is not None}, self.hem)


@dataclass(frozen=True)
class Config:
    """Options of `tryon tailor`."""

    cut: Cut = field(default_factory=Cut)
    shape: BodyShape = field(default_factory=BodyShape)
    asked: Asked = field(default_factory=Asked)
    fabric: str | None = None
    """Fabric, such as gray-interlock; the model's first when not given."""
    refine: bool = False
    """Bring each trial's drape to rest by simulation and correct by that: slower, and true to the simulator."""
    rounds: int = 5
    """How often at most the garment is cut anew."""
    out: Path | None = None
    """Pattern to write, in true size with seam allowance: .svg."""
    garment: Path | None = None
    """Mesh file of the dressed body to write: .glb, .obj, .ply or .npz."""
    picture: Path | None = None
    """Picture to write: .png, .jpg or .webp."""
    views: tuple[str, ...] = ("front", "side", "back")
    """Views of the picture: front, three-quarter, side, back, or degrees."""
    height: int = 900
    """Height of the picture, pixels."""
    report: Path | None = None
    """JSON file for what was asked for, predicted and simulated."""
    seam_allowance: float = SEAM_ALLOWANCE
    """Fabric outside sewn edges, metres."""
    hem_allowance: float = HEM_ALLOWANCE
    """Fabric outside hem and cuffs, metres."""
    weights: Path | None = None
    """File of learned parameters in place of those that come with the package."""


def main(config: Config) -> None:
    """Find the design, write what is asked for, and say what was asked for and what was found, side by side."""
    clock = Clock()
    target, files = config.asked.target(), Target(config.garment, config.picture, None)
    output = OutputOptions(config.views, config.height)
    _check(config, files, output)
    with clock.stage("weights"):
        model = load_pretrained() if config.weights is None else load_model(check_file("--weights", config.weights))
    # One size for all designs: the next round compiles nothing.
    session = Session(model, one_size=True)
    start = resolve_design(session.space, config.cut)
    fabric = session.check_fabric(config.fabric)
    with clock.stage("body"):
        betas, remarks = resolve_betas(session.body, config.shape, session.num_betas)
        judge_betas(betas, model.config.beta_ranges).check("this body")
    found = tailor(
        session, target, betas, start=start, fabric=fabric, refine=config.refine, rounds=config.rounds, stopwatch=clock
    )
    dressed = found.refined or found.dressed
    if dressed.verdict is not None:
        dressed.verdict.check(dressed.garment.label)
    with together():
        written = [*files.write(dressed, "tailored", output, clock)]
        if config.out is not None:
            write_svg(config.out, session.space, found.design, config.seam_allowance, config.hem_allowance)
            written.append(config.out)
        if config.report is not None:
            entry = {**record(dressed, "tailored"), "asked": target.as_dict(), "predicted": found.predicted}
            entry |= {"simulated": found.simulated, "at_bounds": found.at_bounds(session.space)}
            write_text(config.report, json.dumps(entry, indent=2) + "\n")
            written.append(config.report)
    lines = [*report_lines(dressed, remarks), *describe(found, found.at_bounds(session.space))]
    say(*lines, *(f"wrote    {path}" for path in written), clock)


def _check(config: Config, files: Target, output: OutputOptions) -> None:
    """Raise for what cannot be written, before any work is done."""
    files.check()
    output.check()
    if config.out is not None:
        check_choice("format of --out", config.out.suffix.lower(), (".svg",))
    for path in (config.out, config.report):
        if path is not None:
            check_target(path)


def describe(found: Tailored, at_bounds: dict[str, str]) -> list[str]:
    """What was asked for, predicted and simulated, side by side, and what no design can have.

    Args:
        found: From `tailor`.
        at_bounds: Parameters at an end of their range, by name.
    """
    lines = []
    for name, asked in found.target.as_dict().items():
        what = "hem over the floor" if name == HEM else f"ease at the {name}"
        text = f"asked    {what} {100 * asked:.1f} cm: predicted {_cm(found.predicted[name])}"
        lines.append(text if found.simulated is None else f"{text}, simulated {_cm(found.simulated[name])}")
    limits = " and ".join(f"the {which} {name}" for name, which in at_bounds.items())
    for name, miss in found.misses.items():
        if miss is None:
            lines.append(f"note     the garment does not go round the body at the {name}: its ease cannot be had")
        elif abs(miss) > (0.005 if name == HEM else 0.01):
            at = f", with {limits} that the pattern can have" if limits else ""
            lines.append(f"note     {name} is missed by {100 * miss:+.1f} cm{at}")
    return lines


def _cm(value: float | None) -> str:
    return "not round the body" if value is None else f"{100 * value:.1f} cm"
