"""Random designs, bodies, meshes and fabrics through the whole try-on: what raises, tears unseen, or stays inside.

python -m benchmarks campaign --cases 200
python -m benchmarks campaign --resume
python -m benchmarks campaign --cases 20 --seed 7 --no-save

A drape may be refused by the gate; a drape that is torn must be. After the push out no vertex may be inside the body,
by winding numbers, which share no line with the distances that the push out goes by. The record is written every
`EVERY` cases; `--resume` goes on from there.
"""

import json
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from benchmarks.record import RESULTS, write_record
from measuring.records import environment, slug, table
from tryon_jax.metrics.strain import edge_strain
from tryon_jax.tryon import load_model, load_pretrained
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.gate import LIMITS
from tryon_jax.wear.session import Session

EVERY = 50
"""Cases between two writings of the record."""
OUTCOMES = ("fine", "warning", "refused")


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks campaign`."""

    cases: int = 2000
    """Random cases; each is the same for one seed however many there are."""
    seed: int = 0
    bodies: int = 4
    """Bodies for each design and mesh."""
    weights: str | None = None
    """File of learned parameters in place of those that come with the package."""
    resume: bool = False
    """Go on with the record that is there, of the same seed, bodies, weights and commit."""
    save: bool = True
    """Write the record."""


@dataclass
class Tally:
    """What the cases so far came to."""

    cases: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    findings: Counter[str] = field(default_factory=Counter)
    """Cases in which the gate named each measure."""
    longest_edge: float = 0.0
    """Times its rest length, over drapes that were not refused."""
    largest_push: float = 0.0
    """Metres, over the same."""
    seconds: float = 0.0
    faults: list[dict[str, Any]] = field(default_factory=list)

    def row(self) -> dict[str, Any]:
        """For the record."""
        return vars(self) | {"outcomes": dict(self.outcomes), "findings": dict(self.findings)}


def main(config: Config) -> None:
    """Run the cases and say what went wrong; raises where something did."""
    tally = read_tally(config, RESULTS, environment()) if config.resume else Tally()
    if tally.cases < config.cases:
        model = load_pretrained() if config.weights is None else load_model(config.weights)
        session = Session(model, one_size=True)
        while tally.cases < config.cases:
            start = time.perf_counter()
            run_case(session, random_case(session, config.seed, tally.cases, config.bodies), tally)
            tally.cases += 1
            tally.seconds += time.perf_counter() - start
            if config.save and (tally.cases % EVERY == 0 or tally.cases == config.cases):
                write_record("campaign", config, [tally.row()])
                print(f"{tally.cases} cases, {len(tally.faults)} faults, {tally.seconds:.0f} s", flush=True)
    print(summary(tally))
    if tally.faults:
        raise ValueError(f"{len(tally.faults)} of {tally.cases} cases went wrong")


def read_tally(config: Config, folder: Path, surroundings: dict[str, Any]) -> Tally:
    """The tally of the record that this device has begun in `folder`; an empty one where there is none.

    Raises:
        ValueError: it was begun with other options or other code.
    """
    path = folder / f"campaign-{slug(surroundings['device'])}.json"
    if not path.exists():
        return Tally()
    record = json.loads(path.read_text(encoding="utf-8"))
    names = ("seed", "bodies", "weights")
    pairs = [(name, record["config"][name], getattr(config, name)) for name in names]
    pairs += [("commit", record["environment"].get("commit"), surroundings.get("commit"))]
    for name, then, now in pairs:
        if then != now:
            raise ValueError(f"resume: {str(path)!r} was begun with {name} {then!r}, not {now!r}; leave out --resume")
    row = record["rows"][0]
    return Tally(**row | {"outcomes": Counter(row["outcomes"]), "findings": Counter(row["findings"])})


def run_case(session: Session, drawn: dict[str, Any], tally: Tally) -> None:
    """Drape one case and add to the tally what came of it."""
    try:
        dressed = session.try_on(
            session.prepare(drawn["design"], seed=drawn["mesh"]), drawn["betas"], fabric=drawn["fabric"]
        )
    except Exception as error:  # Whatever it is, it is what the campaign looks for.
        tally.faults.append(drawn | {"fault": f"{type(error).__name__}: {error}"})
        return
    assert dressed.verdict is not None
    tally.outcomes[dressed.verdict.outcome] += 1
    tally.findings.update({finding.measure for finding in dressed.verdict.findings})
    if dressed.verdict.outcome == "refused":
        return
    stretch = largest_stretch(dressed)
    tally.longest_edge = max(tally.longest_edge, stretch)
    tally.largest_push = max(tally.largest_push, 0.0 if dressed.pushed is None else float(dressed.pushed.largest_move))
    if stretch > LIMITS["edge"].refuse:
        tally.faults.append(drawn | {"fault": f"an edge of {stretch:.2f} times its rest length was not refused"})
    inside = inside_body(dressed.vertices, dressed.body.vertices, dressed.body.faces)
    if inside.any():
        tally.faults.append(drawn | {"fault": f"{int(inside.sum())} vertices are inside the body"})


def summary(tally: Tally) -> str:
    """Outcomes, what the gate named, worst values and every fault, as text."""
    rows = [{"outcome": name, "cases": tally.outcomes[name]} for name in OUTCOMES]
    rows += [{"outcome": f"named: {name}", "cases": count} for name, count in tally.findings.most_common()]
    lines = [
        table(rows),
        f"{tally.cases} cases, {len(tally.faults)} faults, {tally.seconds / max(tally.cases, 1):.2f} s a case; longest "
        f"edge {tally.longest_edge:.2f} times its rest length, largest push {1e3 * tally.largest_push:.1f} mm",
        *map(str, tally.faults),
    ]
    return "\n".join(lines)


def random_case(session: Session, seed: int, case: int, bodies: int) -> dict[str, Any]:
    """Design, mesh, betas and fabric of one case, by its number."""
    space, extent = session.space, session.model.config.beta_ranges
    design_rng = np.random.default_rng((seed, 0, case // bodies))
    share = design_rng.random(len(space.names))
    mesh = int(design_rng.integers(2**31))
    rng = np.random.default_rng((seed, 1, case))
    way = rng.normal(size=len(extent))
    betas = np.array(extent) * way / np.linalg.norm(way) * rng.random() ** (1 / len(extent))
    return {
        "design": [float(v) for v in space.minimum + share * (space.maximum - space.minimum)],
        "mesh": mesh,
        "betas": [float(beta) for beta in betas],
        "fabric": str(rng.choice(session.fabrics)),
    }


def largest_stretch(dressed: DressedBody) -> float:
    """Longest edge over its rest length, the longer of pattern and mean drape."""
    garment, mean = dressed.garment, dressed.garment.garment.mean_vertices
    against_pattern = edge_strain(dressed.vertices, garment.faces, garment.uv, garment.faces_uv)
    return 1.0 + float(
        np.minimum(against_pattern, edge_strain(dressed.vertices, garment.faces, mean, garment.faces)).max()
    )


def inside_body(
    points: Float[np.ndarray, "V 3"], skin: Float[np.ndarray, "B 3"], faces: Int[np.ndarray, "G 3"]
) -> Bool[np.ndarray, " V"]:
    """Which points are inside a closed surface, by libigl's winding numbers."""
    try:
        from igl import winding_number
    except ImportError:
        raise ModuleNotFoundError("the campaign needs libigl: pip install 'tryon_jax[benchmarks]'") from None
    corners = np.asarray(skin, np.float64)
    return np.asarray(winding_number(corners, faces.astype(np.int64), points.astype(np.float64))) > 0.5
