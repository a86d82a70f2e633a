"""Beyond the paper: time of a drape, of the simulator to the same equilibrium, and of a transfer without learning."""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

from experiments.shared.evaluate import body_vertices, open_model
from experiments.shared.record import RESULTS, publish
from measuring.timing import Timing, measure
from tryon_jax.contact.push_out import push_out
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.files.atomic import atomic_path
from tryon_jax.garment import placement, remesh
from tryon_jax.metrics import vertex_distances
from tryon_jax.physics.cloth import build_cloth
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, dress, follow, sweep
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.physics.state import SolverSettings
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import (
    Garment,
    TryOnModel,
    apply_fields,
    config_space,
    drape,
    drape_fields,
    load_model,
    load_pretrained,
    prepare_mesh,
)

ROWS = {
    "drape": "learned drape, networks included, one body",
    "fields": "learned drape from fields made once, one body",
    "fields, batch": "the same, each of a batch of bodies",
    "paper form": "the paper's form, betas at each node, one body",
    "paper form, batch": "the same, each of a batch of bodies",
    "pushed out": "learned drape and push-out",
    "transfer": "nearest-body-vertex transfer",
    "simulator": "simulator along the ray of shapes, dressed by itself",
    "simulator, at once": "simulator in one step from the mean body",
}
"""What is done for each new body; the first simulator row is the reference of the distances."""


@dataclass(frozen=True)
class Config:
    """What to time."""

    run: Path = Path("runs/small")
    """Folder of the run."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    designs: tuple[str, ...] = ("tshirt", "maxi-dress")
    """Presets."""
    betas: tuple[float, float] = (1.4, -0.9)
    """The body that is dressed; on none of the simulated rays."""
    fabric: str = "gray-interlock"
    """Fabric."""
    paper_form: Path | None = None
    """Model file in the paper's form, timed beside it; by default the one in the package."""
    batch: int = 64
    """Bodies in a batch."""
    ray: int = 8
    """Shapes on the way from the mean body, as on the rays of the dataset."""
    repeats: int = 10
    """Timed calls of each; the simulator gets a third of them."""
    seed: int = 0
    """Seed of the topologies."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Time everything on the same garments and body, and measure how far each result is from the simulation."""
    weights = model_path(config.run)
    model = open_model(weights, config.untrained, (config.fabric,))
    rival = load_pretrained("paper-form") if config.paper_form is None else load_model(config.paper_form)
    garments = [time_garment(model, rival, design, config) for design in tqdm(config.designs, desc="designs")]
    results = {
        "fabric": config.fabric,
        "betas": config.betas,
        "batch": config.batch,
        "flags": os.environ.get("XLA_FLAGS", ""),
        "garments": garments,
    }
    publish(config, "speed", results, markdown, draw, weights=weights)


def time_garment(model: TryOnModel, rival: TryOnModel, design: str, config: Config) -> dict[str, Any]:
    """Times and distances of all rows for one garment."""
    space, betas = config_space(model.config), np.asarray(config.betas)
    once: dict[str, float] = {}

    def prepared():
        mesh = remesh(space, space.preset(design), model.config.target_area, seed=config.seed)
        return mesh, prepare_mesh(model, mesh)

    (mesh, garment), once["mesh and graph of a design (drape)"] = _timed(prepared)
    fabric = load_fabric(config.fabric)
    cloth = build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, mesh.num_vertices)
    obstacle, settings, rest = Obstacle(model.body), SolverSettings(), Equilibrium()
    zero = [0.0] * len(betas)
    start = placement(mesh)
    dress(start, cloth, fabric, obstacle, settings, rest, zero, max_steps=2)
    mean, seconds = _timed(lambda: dress(start, cloth, fabric, obstacle, settings, rest, zero))
    once["dressing the mean body (simulator)"] = seconds
    ray = betas[None] * (np.arange(1, config.ray + 1) / config.ray)[:, None]

    def along() -> Drape:
        return list(sweep(mean, ray, cloth, fabric, obstacle, settings, rest))[-1]

    def at_once() -> Drape:
        return follow(mean, betas, cloth, fabric, obstacle, settings, rest)

    along()
    truth, jump = along(), at_once()
    held, shape = jax.device_put(garment), jnp.asarray(betas, jnp.float32)
    many = jnp.asarray(np.broadcast_to(betas, (config.batch, len(betas))), jnp.float32)
    one = _compiled(model, held, shape, config.fabric)
    make = jax.jit(drape_fields, static_argnames="fabric").lower(model, held, config.fabric).compile()
    fields, once["drape fields of a garment and fabric"] = _timed(lambda: jax.block_until_ready(make(model, held)))
    of_one, of_many = (jax.jit(apply_fields).lower(fields, b).compile() for b in (shape, many))
    rival_held = jax.device_put(prepare_mesh(rival, mesh))
    rival_one, rival_many = (_compiled(rival, rival_held, b, config.fabric) for b in (shape, many))
    predicted = garment.unpad(one(model, held, shape))
    shaped = body_vertices(model, betas[None].astype(np.float32))[0]
    faces = np.asarray(model.body.faces)

    def pushed() -> np.ndarray:
        drawn = garment.unpad(one(model, held, shape))
        return push_out(drawn, garment.faces, ClosedSurface(shaped.astype(np.float64), faces)).vertices

    rest_vertices, template = garment.mean_vertices, np.asarray(model.body.v_template)
    nearest, once["closest body vertices of a design (transfer)"] = _timed(
        lambda: cKDTree(template).query(rest_vertices)[1]
    )

    def transferred() -> np.ndarray:
        moved = body_vertices(model, betas[None].astype(np.float32))[0]
        return rest_vertices + moved[nearest] - template[nearest]

    few = max(3, config.repeats // 3)
    timings = {
        "drape": measure(one, model, held, shape, repeats=config.repeats),
        "fields": measure(of_one, fields, shape, repeats=10 * config.repeats),
        "fields, batch": measure(of_many, fields, many, repeats=10 * config.repeats),
        "paper form": measure(rival_one, rival, rival_held, shape, repeats=config.repeats),
        "paper form, batch": measure(rival_many, rival, rival_held, many, repeats=config.repeats),
        "pushed out": measure(pushed, repeats=few),
        "transfer": measure(transferred, repeats=config.repeats),
        "simulator": _measure_host(along, few),
        "simulator, at once": _measure_host(at_once, few),
    }
    share = {"fields, batch": config.batch, "paper form, batch": config.batch}
    distances = {
        "drape": predicted,
        "fields": garment.unpad(of_one(fields, shape)),
        "paper form": garment.unpad(rival_one(rival, rival_held, shape)),
        "pushed out": pushed(),
        "transfer": transferred(),
        "simulator, at once": jump.vertices,
    }
    return {
        "design": design,
        "vertices": mesh.num_vertices,
        "once_seconds": once,
        "rows": {
            row: {
                "seconds": timing.median / share.get(row, 1),
                "quartiles": [q / share.get(row, 1) for q in (timing.lower_quartile, timing.upper_quartile)],
                "repeats": timing.repeats,
            }
            for row, timing in timings.items()
        },
        "distance_mm": {
            row: 1e3 * float(vertex_distances(found, truth.vertices).mean()) for row, found in distances.items()
        },
        "residual": {"simulator": float(truth.report.residual), "simulator, at once": float(jump.report.residual)},
        "tolerance": rest.tolerance,
    }


def _compiled(model: TryOnModel, garment: Garment, betas: jax.Array, fabric: str) -> Callable[..., jax.Array]:
    return jax.jit(drape, static_argnames="fabric").lower(model, garment, betas, fabric).compile()


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    begin = time.perf_counter()
    result = work()
    return result, time.perf_counter() - begin


def _measure_host(work: Callable[[], Drape], repeats: int) -> Timing:
    """Times of something that is compiled already and too slow for a warm-up."""
    times = [_timed(lambda: work().vertices)[1] for _ in range(repeats)]
    low, middle, high = np.quantile(times, [0.25, 0.5, 0.75])
    return Timing(times[0], float(middle), float(low), float(high), repeats)


def markdown(results: Mapping[str, Any]) -> list[str]:
    """One table for each garment, and what is paid once."""
    lines = []
    for garment in results["garments"]:
        drape_seconds = garment["rows"]["drape"]["seconds"]
        lines += [
            f"**{garment['design']}**, {garment['vertices']} vertices, {results['fabric']}, betas "
            f"{', '.join(f'{b:g}' for b in results['betas'])}",
            "",
            "| for each new body | median time, ms (quartiles) | ÷ one learned drape | mean distance from the "
            "simulation, mm |",
            "|---|---|---|---|",
        ]
        for row, title in ROWS.items():
            entry = garment["rows"][row]
            low, high = (1e3 * q for q in entry["quartiles"])
            apart = garment["distance_mm"].get(row)
            reached = garment["residual"].get(row)
            note = (
                "" if reached is None or reached <= garment["tolerance"] else f", residual {reached:.3f}: not at rest"
            )
            lines.append(
                f"| {title}{note} | {_three(1e3 * entry['seconds'])} ({_three(low)} to {_three(high)}) | "
                f"{_three(entry['seconds'] / drape_seconds)} | {'–' if apart is None else f'{apart:.2f}'} |"
            )
        once = ", ".join(f"{title} {seconds:.2f} s" for title, seconds in garment["once_seconds"].items())
        lines += ["", f"Once for each design: {once}.", ""]
    factors = [g["rows"]["simulator"]["seconds"] / g["rows"]["drape"]["seconds"] for g in results["garments"]]
    rows = [g["rows"] for g in results["garments"]]
    gains = [[r[f"paper form{b}"]["seconds"] / r[f"fields{b}"]["seconds"] for r in rows] for b in ("", ", batch")]
    nearer = all(g["distance_mm"]["drape"] < g["distance_mm"]["transfer"] for g in results["garments"])
    return [
        *lines,
        f"The learned drape is {min(factors):.0f} to {max(factors):.0f} times faster than the simulator at a residual "
        f"of {results['garments'][0]['tolerance']:g} of the load, on the same machine.",
        "",
        f"From fields made once, a new body is {min(gains[0]):.0f} to {max(gains[0]):.0f} times faster than in the "
        f"paper's form, and {min(gains[1]):.0f} to {max(gains[1]):.0f} times in a batch of {results['batch']}.",
        "",
        f"It is nearer to the simulation than the transfer: {'supported' if nearer else 'not supported'}.",
    ]


def _three(value: float) -> str:
    """Three digits or more, never with an exponent."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def draw(path: Path, results: Mapping[str, Any]) -> None:
    """Distance from the simulation over time for each new body."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.8, 3.6), dpi=110, layout="constrained")
    axis = figure.subplots()
    for garment, marker in zip(results["garments"], "osD^v", strict=False):
        for number, (row, title) in enumerate(ROWS.items()):
            apart = 0.0 if row == "simulator" else garment["distance_mm"].get(row)
            if apart is None:
                continue
            label = f"{title}" if garment is results["garments"][0] else None
            axis.plot(1e3 * garment["rows"][row]["seconds"], apart, marker, color=f"C{number}", label=label)
    axis.set_xscale("log")
    axis.set_ylim(bottom=-1)
    axis.set_xlabel("ms for each new body")
    axis.set_ylabel("mean distance from the simulation, mm")
    names = " · ".join(
        f"{shape} {garment['design']}" for shape, garment in zip("●■◆▲▼", results["garments"], strict=False)
    )
    axis.set_title(names, fontsize=9)
    axis.legend(fontsize=7)
    axis.spines[["top", "right"]].set_visible(False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
