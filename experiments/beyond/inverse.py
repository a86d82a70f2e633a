"""Beyond the paper: which pattern and body made a drape, and which pattern gives the fit that is asked for."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

from experiments.beyond.template import template_projection
from experiments.shared.evaluate import case_names, open_model, spread
from experiments.shared.figures import dressed_cell
from experiments.shared.neighbours import load_drapes
from experiments.shared.record import RESULTS, publish
from tryon_jax.files.atomic import atomic_path
from tryon_jax.garment import GarmentMesh, remesh
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.render import SheetItem, contact_sheet
from tryon_jax.training.dataset import default_root, load_arrays, mesh_path
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import Garment, TryOnModel, config_space, drape, prepare_mesh
from tryon_jax.wear.session import Session
from tryon_jax.wear.tailor import FitTarget, sitting, tailor
from tryon_jax.wear.unknowns import Found, Unknowns, solve

BUCKET = 4608
"""Most garments of the design space fit, so that one size is compiled; larger ones get their own."""


@dataclass(frozen=True)
class Config:
    """What to solve."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset: the simulator's target drapes."""
    run: Path = Path("runs/small")
    """Folder of the run."""
    out: Path = RESULTS
    """Folder for the record and the pictures."""
    fabric: str = "gray-interlock"
    """Fabric."""
    own: int = 4
    """Target drapes that the model makes itself, of random designs and bodies."""
    simulated: int = 6
    """Target drapes of the simulator: test shapes of unseen designs (of trained ones where none is simulated)."""
    fits: tuple[tuple[float, float, float, float], ...] = (
        (-1.0, 0.5, 0.10, 0.48),
        (1.5, -0.8, 0.20, 0.38),
        (0.5, 0.6, 0.05, 0.30),
    )
    """Fits asked for: the two betas of a body, ease at the chest in metres, height of the hem over stature."""
    rounds: int = 3
    """The garment is meshed anew at the design found, so often."""
    steps: int = 30
    """Steps of the solver in each round, at most."""
    seed: int = 0
    """Of random targets."""
    simulate: bool = True
    """Check the fits with the simulator too."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


class InverseProblems:
    """A model with what solving for its inputs needs; garments are meshed on the host between rounds."""

    def __init__(self, model: TryOnModel, fabric: str, bucket: int = BUCKET) -> None:
        self.model, self.fabric, self.bucket = model, fabric, bucket
        self.space = config_space(model.config)
        size = len(self.space.names)

        # Made once, so that each is compiled once.
        def recover(units: Float[Array, " U"], args: Any) -> Float[Array, " R"]:
            unknowns, garment, projection, target, weights = args
            values = unknowns.values(units)
            vertices = drape(model, garment, values[size:], fabric=fabric, design=values[:size])
            misses = 1e3 * weights[:, None] * (projection @ vertices - target)
            return jnp.concatenate([misses.ravel(), unknowns.beyond(units)])

        self._recover = recover

    def garment(self, values: np.ndarray, seed: int = 0) -> tuple[Garment, GarmentMesh]:
        """The garment of a design, meshed anew."""
        inside = np.clip(values.astype(float), self.space.minimum, self.space.maximum)
        mesh = remesh(self.space, self.space.from_values(inside), self.model.config.target_area, seed=seed)
        # Halvings of the graph need a little more room than its vertices.
        bucket = self.bucket if mesh.num_vertices <= 0.98 * self.bucket else None
        return prepare_mesh(self.model, mesh, bucket=bucket), mesh

    def recover(
        self, target: Float[np.ndarray, "T 3"], seen: Float[np.ndarray, " T"], rounds: int, steps: int
    ) -> tuple[np.ndarray, np.ndarray, Found]:
        """Design and betas whose drape is nearest to a target, at the template's vertices with weights `seen`."""
        unknowns = Unknowns.of(self.space, self.model.config.beta_ranges)
        units, found = unknowns.units(np.concatenate([self.space.mean, np.zeros(self.model.config.num_betas)])), None
        size, total, residuals = len(self.space.names), 0, []
        for _ in range(rounds):
            garment, mesh = self.garment(np.asarray(unknowns.values(units))[:size])
            projection = np.zeros((len(target), garment.graph.num_nodes), np.float32)
            own, weights = template_projection(mesh.template_vertices, mesh.template_weights, len(target))
            projection[:, : mesh.num_vertices] = own
            arguments = (unknowns, garment, projection, target, np.minimum(weights, seen))
            found = solve(self._recover, units, arguments, steps)
            units, total = found.units, total + found.steps
            residuals.append(found.residual)
        values = np.asarray(unknowns.values(units))
        return values[:size], values[size:], Found(units, total, residuals[-1], residuals)


def main(config: Config) -> None:
    """Solve all problems and print, draw and store how near the answers are."""
    manifest, weights = load_manifest(), model_path(config.run)
    model = open_model(weights, config.untrained, (config.fabric,))
    problems = InverseProblems(model, config.fabric)
    recovered = [
        *(_own(problems, config, k) for k in tqdm(range(config.own), desc="own drapes", mininterval=2)),
    ]
    cases = case_names(config.data, manifest) if config.simulated else {"unseen design": [], "as trained": []}
    names = cases["unseen design"] or cases["as trained"]
    names = [names[k] for k in spread(len(names), config.simulated)] if config.simulated else []
    recovered += [_simulated(problems, config, name) for name in tqdm(names, desc="simulated drapes", mininterval=2)]
    fits, items, session = [], [], Session(model, one_size=True)
    for asked in tqdm(config.fits, desc="fits", mininterval=2):
        entry, cells = _find_design(session, config, asked)
        fits.append(entry)
        items += cells
    results = {"fabric": config.fabric, "recovered": recovered, "fits": fits, "names": list(problems.space.names)}
    publish(config, "inverse", results, markdown, draw, garments=names or None, weights=weights)
    if items:
        contact_sheet(config.out / "inverse.jpg", items, columns=len(items) // len(config.fits), height=330)


def _own(problems: InverseProblems, config: Config, number: int) -> dict[str, Any]:
    rng = np.random.default_rng((config.seed, number))
    unit = rng.uniform(0.1, 0.9, len(problems.space.names))
    design = problems.space.minimum + unit * (problems.space.maximum - problems.space.minimum)
    betas = rng.uniform(-1.0, 1.0, problems.model.config.num_betas) * np.array([2.0, 1.3])
    garment, mesh = problems.garment(design, seed=900 + number)
    vertices = garment.unpad(drape(problems.model, garment, betas.astype(np.float32), fabric=config.fabric))
    return _recovered(problems, config, "the model", f"random {number}", vertices, mesh, design, betas)


def _simulated(problems: InverseProblems, config: Config, name: str) -> dict[str, Any]:
    drapes = load_drapes(problems.model, config.data, name, config.fabric)
    rows = np.flatnonzero(drapes.good & drapes.test)
    # Neither the ends nor the middle of the range.
    row = rows[np.abs(np.linalg.norm(drapes.betas[rows], axis=1) - 1.2).argmin()]
    mesh = load_arrays(mesh_path(config.data, name))
    return _recovered(
        problems, config, "the simulator", name, drapes.vertices[row], mesh, drapes.design, drapes.betas[row]
    )


def _recovered(
    problems: InverseProblems,
    config: Config,
    maker: str,
    name: str,
    vertices: np.ndarray,
    mesh: GarmentMesh | Mapping[str, np.ndarray],
    design: np.ndarray,
    betas: np.ndarray,
) -> dict[str, Any]:
    corners, weights = (
        (mesh.template_vertices, mesh.template_weights)
        if isinstance(mesh, GarmentMesh)
        else (mesh["template_vertices"], mesh["template_weights"])
    )
    size = problems.model.config.template_vertices
    projection, seen = template_projection(corners, weights, size)
    target = projection @ vertices.astype(np.float32)
    began = time.perf_counter()
    found_design, found_betas, found = problems.recover(target, seen, config.rounds, config.steps)
    return {
        "maker": maker,
        "name": name,
        "design": design,
        "betas": betas,
        "found_design": found_design,
        "found_betas": found_betas,
        "design_error_mm": 1e3 * np.abs(found_design - design),
        "betas_error": np.abs(found_betas - betas),
        "residual_mm": found.rounds,
        "steps": found.steps,
        "seconds": time.perf_counter() - began,
    }


def _find_design(
    session: Session, config: Config, asked: tuple[float, float, float, float]
) -> tuple[dict[str, Any], list[SheetItem]]:
    betas = np.array(asked[:2])
    body = session.shape(betas)
    target = FitTarget({"chest": asked[2]}, asked[3] * body.measurements["stature"])
    began = time.perf_counter()
    found = tailor(session, target, betas, fabric=config.fabric)
    seconds = time.perf_counter() - began
    drapes = {"predicted": found.dressed}
    if config.simulate:
        drapes["simulated"] = session.simulate(found.dressed.garment, betas, fabric=config.fabric)
    got = {kind: list(sitting(dressed, session, target).values()) for kind, dressed in drapes.items()}
    items = [
        dressed_cell(
            session.body,
            body.vertices,
            (dressed.vertices, dressed.faces),
            f"{kind}: ease {_cm(got[kind][0])}, hem {_cm(got[kind][1])}",
        )
        for kind, dressed in drapes.items()
    ]
    entry = {
        "betas": betas,
        "asked": list(target.as_dict().values()),
        "design": found.design.values,
        "got": got,
        "rounds": found.rounds,
        "seconds": seconds,
    }
    return entry, items


def _cm(value: float | None) -> str:
    return "none" if value is None else f"{100 * value:.1f} cm"


def markdown(results: Mapping[str, Any]) -> list[str]:
    """Tables of both problems."""
    names = results["names"]
    lines = [
        f"Design and betas from a drape in {results['fabric']}, seen at the template's vertices; the solver starts "
        "from the mean design on the mean body and does not know the target's mesh.",
        "",
        "| target made by | "
        + " | ".join(f"{n}, mm off" for n in names)
        + " | betas off | residual, mm | steps | seconds |",
        "|---|" + "---|" * (len(names) + 4),
    ]
    for maker in dict.fromkeys(entry["maker"] for entry in results["recovered"]):
        chosen = [entry for entry in results["recovered"] if entry["maker"] == maker]
        design = np.mean([entry["design_error_mm"] for entry in chosen], axis=0)
        worst = np.max([entry["design_error_mm"] for entry in chosen], axis=0)
        betas = np.mean([entry["betas_error"] for entry in chosen], axis=0)
        cells = [f"{mean:.1f} (worst {most:.1f})" for mean, most in zip(design, worst, strict=True)]
        residual = np.mean([entry["residual_mm"][-1] for entry in chosen])
        steps, seconds = (np.mean([entry[key] for entry in chosen]) for key in ("steps", "seconds"))
        lines.append(
            f"| {maker} ({len(chosen)} drapes) | {' | '.join(cells)} | {' · '.join(f'{b:.3f}' for b in betas)} | "
            f"{residual:.2f} | {steps:.0f} | {seconds:.1f} |"
        )
    fits = results["fits"]
    if fits:
        lines += [
            "",
            "| asked: body (betas), ease at the chest, height of the hem, cm | design found, cm | "
            "model's drape: ease · hem, cm | simulated: ease · hem, cm | rounds | seconds |",
            "|---|---|---|---|---|---|",
        ]
    for entry in fits:
        shape = ", ".join(f"{b:g}" for b in entry["betas"])
        ease, hem = (f"{100 * value:.1f}" for value in entry["asked"])
        design = " · ".join(f"{100 * v:.1f}" for v in entry["design"])
        got = [
            " · ".join(f"{100 * v:.1f}" for v in entry["got"][kind]) if kind in entry["got"] else "–"
            for kind in ("predicted", "simulated")
        ]
        lines.append(
            f"| {shape}: {ease} · {hem} | {design} | {got[0]} | {got[1]} | {entry['rounds']} | {entry['seconds']:.1f} |"
        )
    return lines


def draw(path: Path, results: Mapping[str, Any]) -> None:
    """Found over true values of each unknown."""
    from matplotlib.figure import Figure

    entries = results["recovered"]
    titles = [*(f"{n}, m" for n in results["names"]), *(f"beta {k + 1}" for k in range(2))]
    figure = Figure(figsize=(2.5 * len(titles), 2.9), dpi=100, layout="constrained")
    axes = figure.subplots(1, len(titles))
    makers = dict(zip(("the model", "the simulator"), ("o", "x"), strict=True))
    for k, (axis, title) in enumerate(zip(axes, titles, strict=True)):
        for maker, marker in makers.items():
            chosen = [e for e in entries if e["maker"] == maker]
            true = [float(np.concatenate([e["design"], e["betas"]])[k]) for e in chosen]
            found = [float(np.concatenate([e["found_design"], e["found_betas"]])[k]) for e in chosen]
            axis.plot(true, found, marker, label=f"target: {maker}")
        low, high = axis.get_xlim()
        axis.plot([low, high], [low, high], color="0.7", linewidth=1, zorder=0)
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("true", fontsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("found", fontsize=8)
    axes[0].legend(fontsize=7)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
