"""Arms down: drapes followed by the simulator from the T-pose, beside T-pose drapes that are merely skinned."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from experiments.shared.figures import dressed_cell
from experiments.shared.record import RESULTS, publish
from tryon_jax.body.stance import LOWEST, arms_pose
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.contact.skin import Skin
from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.physics.stance import StanceObstacle
from tryon_jax.render import SheetItem, contact_sheet
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.posing import pose_dressed
from tryon_jax.wear.session import Session
from tryon_jax.wear.simulate import NotSettled

FIELDS = (0, 2, 4, 8)
"""Numbers K of fields that ranks are told for."""


@dataclass(frozen=True)
class Config:
    """What to drape."""

    designs: tuple[str, ...] = ("tank", "tshirt", "longsleeve", "sweater", "dress", "sweater-dress")
    """Presets."""
    fabrics: tuple[str, ...] = ("gray-interlock", "white-dots-on-blk")
    betas: tuple[tuple[float, float], ...] = ((0.0, 0.0), (1.5, -0.8), (-1.5, 0.8))
    """Bodies."""
    out: Path = RESULTS
    """Folder for the record and the picture."""


@dataclass(frozen=True, eq=False)
class Descent:
    """One garment on one body while the arms come down."""

    dressed: DressedBody
    """At rest in T-pose."""
    rows: list[dict[str, float]]
    """One for each stance."""
    unposed: Float[np.ndarray, "S V 3"]
    """Each drape carried back to the T-pose by its skinning, minus the one there, metres."""
    last: Float[np.ndarray, "V 3"]
    """The last drape, metres."""


def main(config: Config) -> None:
    """Follow every garment on every body, and draw one of each design."""
    session, descents, unsettled = Session(one_size=True), [], []
    garments = {design: session.prepare(design) for design in config.designs}
    jobs = [(d, f, b) for d in config.designs for f in config.fabrics for b in config.betas]
    for design, fabric, betas in tqdm(jobs, desc="descents", mininterval=2):
        dressed = session.drape(garments[design], betas, fabric=fabric)
        try:
            descents.append(follow(session, session.refine(dressed), fabric))
        except NotSettled:
            unsettled.append(f"{design} in {fabric} on {betas}")
    results = {
        "descents": len(descents),
        "unsettled": unsettled,
        "lowest": LOWEST,
        "stances": _average([d.rows for d in descents]),
        "rank": ranks(descents),
    }
    publish(config, "stance", results, markdown)
    _draw(config, session, descents)


def follow(session: Session, dressed: DressedBody, fabric: str) -> Descent:
    """Lower the arms under one drape and measure each stance.

    Args:
        session: What dressed the body.
        dressed: At rest in T-pose.
        fabric: Its fabric.
    """
    weights, seen = session.skinning(dressed.garment), []
    began = time.process_time()

    def note(degrees: float, residual: float, vertices: np.ndarray) -> None:
        seen.append((degrees, vertices.copy(), residual, time.process_time() - began))

    simulator, betas = session.simulator, dressed.body.betas
    simulator.lower_arms(dressed.vertices, dressed.garment.pattern, load_fabric(fabric), betas, weights, LOWEST, note)
    obstacle = StanceObstacle(simulator.obstacle, betas)
    rows, unposed, before = [], [], 0.0
    for degrees, vertices, residual, seconds in seen:
        pose = arms_pose(session.body, degrees).astype(np.float32)
        skin, skinned = map(
            np.asarray, pose_dressed(session.body, dressed.body.vertices, dressed.vertices, weights, pose)
        )
        posed = Skin(session.body, ClosedSurface(skin, np.asarray(session.body.faces)))
        row = {
            "degrees": float(degrees),
            "seconds": seconds - before,
            "at_rest": residual <= simulator.equilibrium.tolerance,
        }
        row["skinned_mm"] = 1e3 * float(np.linalg.norm(skinned - vertices, axis=1).mean())
        for kind, drape in (("skinned", skinned), ("simulated", vertices)):
            row[f"{kind}_inside"] = posed.penetration(drape, dressed.faces).surface
            row[f"{kind}_crossed"] = float(self_intersecting_faces(drape, dressed.faces).mean())
        rows.append({key: float(value) for key, value in row.items()})
        unposed.append(obstacle.carry(vertices.astype(np.float64), weights, degrees, 0.0) - dressed.vertices)
        before = seconds
    return Descent(dressed, rows, np.array(unposed), seen[-1][1])


def ranks(descents: Sequence[Descent]) -> dict[str, float]:
    """How far the unposed change of each garment and fabric, over bodies and stances, is from a sum of K fields, mm."""
    groups: dict[tuple[str, str], list[Descent]] = {}
    for descent in descents:
        groups.setdefault((descent.dressed.garment.label, descent.dressed.fabric), []).append(descent)
    found: dict[str, list[float]] = {}
    for group in groups.values():
        change = np.concatenate([descent.unposed for descent in group])
        flat = change.reshape(len(change), -1)
        left, sizes, right = np.linalg.svd(flat, full_matrices=False)
        for count in FIELDS:
            rest = (left[:, count:] * sizes[count:]) @ right[count:]
            found.setdefault(str(count), []).append(
                1e3 * float(np.linalg.norm(rest.reshape(change.shape), axis=2).mean())
            )
    return {count: float(np.mean(values)) for count, values in found.items()}


def _average(tables: Sequence[Sequence[Mapping[str, float]]]) -> list[dict[str, float]]:
    """The mean of each stance over descents; stances in between, where one went in smaller steps, are left out."""
    common = set.intersection(*[{row["degrees"] for row in table} for table in tables])
    by_stance = [[row for table in tables for row in table if row["degrees"] == degrees] for degrees in sorted(common)]
    return [{key: float(np.mean([row[key] for row in rows])) for key in rows[0]} for rows in by_stance]


def _draw(config: Config, session: Session, descents: Sequence[Descent]) -> None:
    """One body in each design, skinned above and simulated below."""
    shown = {d.dressed.garment.label: d for d in descents if d.dressed.fabric == config.fabrics[0]}
    pose = arms_pose(session.body, LOWEST).astype(np.float32)
    cells: dict[str, list[SheetItem]] = {"skinned": [], "simulated": []}
    for descent in shown.values():
        dressed = descent.dressed
        weights = session.skinning(dressed.garment)
        skin, skinned = pose_dressed(session.body, dressed.body.vertices, dressed.vertices, weights, pose)
        for kind, drape in (("skinned", np.asarray(skinned)), ("simulated", descent.last)):
            cells[kind].append(dressed_cell(session.body, np.asarray(skin), (drape, dressed.faces), kind))
    items = [cell for row in cells.values() for cell in row]
    contact_sheet(config.out / "stance.jpg", items, columns=len(shown), crop="garment", height=300)
    print(f"wrote {config.out / 'stance.jpg'}")


def markdown(results: Mapping[str, Any]) -> list[str]:
    """One row for each stance, and the ranks."""
    unsettled = results["unsettled"]
    lines = [
        f"{results['descents']} descents of the arms, from refined drapes in T-pose; "
        f"{len(unsettled)} more found no rest and were refused{': ' if unsettled else ''}{'; '.join(unsettled)}. "
        "*Skinned*: the T-pose drape moved "
        "with the nearest skin, as `--pose` does. *Simulated*: `--refine --arms`. Inside: share of the cloth inside "
        "the posed body, before any push-out. Crossed: share of triangles that pass through others.",
        "",
        "| arms below the horizontal | skinned from simulated, mm | inside, skinned · simulated, % | "
        "crossed, skinned · simulated, % | at rest | processor time, s |",
        "|---|---|---|---|---|---|",
    ]
    for row in results["stances"]:
        inside = " · ".join(f"{100 * row[f'{kind}_inside']:.2f}" for kind in ("skinned", "simulated"))
        crossed = " · ".join(f"{100 * row[f'{kind}_crossed']:.3f}" for kind in ("skinned", "simulated"))
        lines.append(
            f"| {row['degrees']:g}° | {row['skinned_mm']:.1f} | {inside} | {crossed} | {row['at_rest']:.0%} | "
            f"{row['seconds']:.2f} |"
        )
    fields = ", ".join(f"{value:.2f} mm for K = {count}" for count, value in results["rank"].items())
    return [
        *lines,
        "",
        "Carried back to the T-pose by its skinning, what a garment changes over these bodies and stances is nearly of "
        f"low rank. Left over beyond the best sum of K fields: {fields}.",
    ]
