"""Beyond the paper: do garments made to measure sit as asked, by the simulator that the networks never asked?"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments.shared.evaluate import open_model
from experiments.shared.figures import dressed_cell
from experiments.shared.record import RESULTS, publish
from tryon_jax.render import contact_sheet
from tryon_jax.training.collisions import random_betas
from tryon_jax.training.run_folder import model_path
from tryon_jax.wear.session import Session
from tryon_jax.wear.tailor import HEM, FitTarget, Tailored, sitting, tailor

EASE_WITHIN, HEM_WITHIN = 0.010, 0.005
"""Metres: what counts as met."""
_LEAST_EASE = 0.02
"""Metres: cloth lies outside the body, and folds a little."""
_SHOWN = 5


@dataclass(frozen=True)
class Config:
    """What to try."""

    run: Path = Path("runs/small")
    """Folder of the run."""
    out: Path = RESULTS
    """Folder for the record and the pictures."""
    cases: int = 50
    """Random bodies, each with an ease and a hem of its own."""
    fabric: str = "gray-interlock"
    """Fabric."""
    refine: bool = True
    """Bring each trial's drape to rest by the simulator and correct by that, as `tryon tailor --refine` does."""
    seed: int = 0
    """Of bodies and fits."""


def main(config: Config) -> None:
    """Tailor, dress each result anew by the simulator, and say how often it sits as asked."""
    weights = model_path(config.run)
    session = Session(open_model(weights, False, (config.fabric,)), one_size=True)
    rng = np.random.default_rng(config.seed)
    bodies = random_betas(rng, 8 * config.cases, session.model.config.beta_ranges)
    bodies = [betas for betas in bodies if _most_ease(session, betas) > _LEAST_EASE][: config.cases]
    cases, items = [], []
    for betas in tqdm(bodies, desc="fits", mininterval=2):
        target = _possible(session, betas, rng)
        began = time.perf_counter()
        found = tailor(session, target, betas, start="tshirt", fabric=config.fabric, refine=config.refine)
        seconds = time.perf_counter() - began
        dressed = session.simulate(found.dressed.garment, betas, fabric=config.fabric)
        got = sitting(dressed, session, target)
        cases.append(_entry(betas, target, found, got, seconds))
        if len(items) < _SHOWN:
            title = ", ".join(f"{k} {100 * v:.0f}: {_cm(got[k])}" for k, v in target.as_dict().items())
            items.append(dressed_cell(session.body, dressed.body.vertices, (dressed.vertices, dressed.faces), title))
    results = {"fabric": config.fabric, "refine": config.refine, "cases": cases}
    publish(config, "made_to_measure", results, markdown, weights=weights)
    contact_sheet(config.out / "made_to_measure.jpg", items, columns=len(items), height=330)


def _range(session: Session, name: str) -> tuple[float, float]:
    """A parameter's range without the tenths at its ends."""
    space = session.space
    k = space.names.index(name)
    low, high = float(space.minimum[k]), float(space.maximum[k])
    return low + 0.1 * (high - low), high - 0.1 * (high - low)


def _most_ease(session: Session, betas: np.ndarray) -> float:
    """The largest ease at the chest that the pattern can give a body, metres."""
    return _range(session, "chest")[1] - session.shape(betas).measurements["chest"]


def _possible(session: Session, betas: np.ndarray, rng: np.random.Generator) -> FitTarget:
    """An ease and a hem that the pattern can give this body."""
    body = session.shape(betas)
    low, _ = _range(session, "chest")
    ease = rng.uniform(max(_LEAST_EASE, low - body.measurements["chest"]), _most_ease(session, betas))
    shoulder = session.drape(session.prepare("tshirt"), betas).vertices[:, 1].max() - body.vertices[:, 1].min()
    return FitTarget({"chest": float(ease)}, float(shoulder - rng.uniform(*_range(session, "length"))))


def _entry(
    betas: np.ndarray, target: FitTarget, found: Tailored, got: Mapping[str, float | None], seconds: float
) -> dict[str, Any]:
    return {
        "betas": betas,
        "asked": target.as_dict(),
        "design": found.design.as_dict(),
        "predicted": found.predicted,
        "refined": found.simulated,
        "dressed": dict(got),
        "rounds": found.rounds,
        "seconds": seconds,
    }


def met(case: Mapping[str, Any], by: str = "dressed") -> bool:
    """Whether a fit is as asked.

    Args:
        case: An entry of the record.
        by: Whose lengths: "predicted", "refined" or "dressed".
    """
    return all(
        case[by][name] is not None and abs(case[by][name] - asked) <= (HEM_WITHIN if name == HEM else EASE_WITHIN)
        for name, asked in case["asked"].items()
    )


def markdown(results: Mapping[str, Any]) -> list[str]:
    """How often fits are met, and how far they are off."""
    cases = results["cases"]
    how = "with the simulator's corrections (`--refine`)" if results["refine"] else "by the networks alone"
    seconds, rounds = (np.mean([case[key] for case in cases]) for key in ("seconds", "rounds"))
    lines = [
        f"{len(cases)} random bodies in {results['fabric']} that the pattern's widest chest goes round, each with a "
        f"random ease at the chest and height of the hem, tailored {how} from the T-shirt, {seconds:.1f} s and "
        f"{rounds:.1f} rounds each. Met: ease within {1e3 * EASE_WITHIN:.0f} mm and hem within "
        f"{1e3 * HEM_WITHIN:.0f} mm.",
        "",
        "| lengths of | met | ease off, mm: median (worst) | hem off, mm: median (worst) |",
        "|---|---|---|---|",
    ]
    titles = {
        "predicted": "the learned drape, pushed out",
        "refined": "that drape brought to rest",
        "dressed": "the garment dressed anew by the simulator",
    }
    for kind, title in titles.items():
        if cases[0][kind] is None:
            continue
        ease, hem = (
            np.abs([case[kind][name] - case["asked"][name] for case in cases if case[kind][name] is not None])
            for name in ("chest", HEM)
        )
        count = sum(met(case, kind) for case in cases)
        lines.append(
            f"| {title} | {count} of {len(cases)} | {1e3 * np.median(ease):.1f} ({1e3 * ease.max():.1f}) | "
            f"{1e3 * np.median(hem):.1f} ({1e3 * hem.max():.1f}) |"
        )
    return lines


def _cm(value: float | None) -> str:
    return "none" if value is None else f"{100 * value:.1f} cm"
