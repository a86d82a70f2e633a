"""Random designs, bodies, meshes and fabrics through the whole try-on: what raises, tears unseen, or stays inside.

python -m benchmarks campaign --cases 200
python -m benchmarks campaign --cases 20 --seed 7 --no-save

A drape may be refused by the gate; a drape that is torn must be. After the push out no vertex may be inside the body,
by winding numbers, which share no line with the distances that the push out goes by.
"""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from benchmarks.record import write_record
from measuring.records import table
from tryon_jax.metrics.strain import edge_strain
from tryon_jax.tryon import load_model, load_pretrained
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.gate import LIMITS
from tryon_jax.wear.session import Session


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
    save: bool = True
    """Write the record."""


def main(config: Config) -> None:
    """Run the cases and say what went wrong; raises where something did."""
    model = load_pretrained() if config.weights is None else load_model(config.weights)
    session = Session(model, one_size=True)
    outcomes: Counter[str] = Counter()
    faults: list[dict[str, Any]] = []
    worst = {"edge": 0.0, "push": 0.0}
    for case in range(config.cases):
        drawn = random_case(session, config.seed, case, config.bodies)
        try:
            dressed = session.try_on(
                session.prepare(drawn["design"], seed=drawn["mesh"]), drawn["betas"], fabric=drawn["fabric"]
            )
        except Exception as error:  # Whatever it is, it is what the campaign looks for.
            faults.append(drawn | {"fault": f"{type(error).__name__}: {error}"})
            continue
        assert dressed.verdict is not None
        outcomes[dressed.verdict.outcome] += 1
        stretch = largest_stretch(dressed)
        worst["edge"] = max(worst["edge"], stretch)
        worst["push"] = max(worst["push"], 0.0 if dressed.pushed is None else dressed.pushed.largest_move)
        if stretch > LIMITS["edge"].refuse and dressed.verdict.outcome != "refused":
            faults.append(drawn | {"fault": f"an edge of {stretch:.2f} times its rest length was not refused"})
        inside = inside_body(dressed.vertices, dressed.body.vertices, dressed.body.faces)
        if inside.any() and dressed.verdict.outcome != "refused":
            faults.append(drawn | {"fault": f"{int(inside.sum())} vertices are inside the body"})
    rows = [{"outcome": name, "cases": outcomes[name]} for name in ("fine", "warning", "refused")]
    print(table(rows))
    print(f"longest edge {worst['edge']:.2f} times its rest length, largest push {1e3 * worst['push']:.1f} mm")
    for fault in faults:
        print(fault)
    if config.save:
        write_record("campaign", config, [{**outcomes, **worst, "faults": faults}])
    if faults:
        raise ValueError(f"{len(faults)} of {config.cases} cases went wrong")


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
    points: Float[np.ndarray, "V 3"], skin: Float[np.ndarray, "B 3"], faces: Int[np.ndarray, "G 3"], near: float = 0.02
) -> Bool[np.ndarray, " V"]:
    """Which points are inside a closed surface, by winding numbers; those farther than `near` metres are not asked."""
    inside = np.zeros(len(points), bool)
    asked = np.flatnonzero(cKDTree(skin).query(points)[0] < near)
    corners = np.asarray(skin, np.float64)[faces]
    for rows in np.array_split(asked, max(1, len(asked) // 64)):
        a, b, c = (corners[None, :, k] - points[rows, None] for k in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        above = np.einsum("pfc,pfc->pf", a, np.cross(b, c))
        dots = [np.einsum("pfc,pfc->pf", u, v) for u, v in ((a, b), (b, c), (c, a))]
        below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
        inside[rows] = np.arctan2(above, below).sum(axis=1) / (2 * np.pi) > 0.5
    return inside
