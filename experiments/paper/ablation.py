"""What each part is worth: equal short trainings that differ in one thing, beside baselines that learn nothing."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from experiments.paper.variants import (
    BLOCK,
    VARIANTS,
    along_first,
    in_block,
    measure_variant,
    options_record,
    train_variant,
    variant_config,
    variant_garments,
)
from experiments.shared.evaluate import case_names, held_out_rows, load_all, ray_ends, spread
from experiments.shared.neighbours import NearestGarments, load_drapes, transfer
from experiments.shared.record import RESULTS, publish
from tryon_jax.files.atomic import atomic_path, write_text
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.metrics import vertex_distances
from tryon_jax.nets.config import load_config
from tryon_jax.nets.store import hash_arrays
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.loop import LoopOptions
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.training_set import dataset_checksum, training_names
from tryon_jax.tryon import TryOnModel, init_model, load_model, save_model

BASELINES = {
    "mean drape": "do nothing: M̄",
    "transfer": "M̄ moved with the nearest body vertex",
    "neighbours": "nearest training garments (kNN), no learning",
    "neighbours, design": "the same with the design in the key",
}
CASES = {"as trained": "trained designs", "unseen topology": "unseen topologies", "unseen design": "unseen designs"}
AIM = 1.5
"""Error on held-out betas over the mean that is aimed at."""


@dataclass(frozen=True)
class Config:
    """What to train and measure; variants that are trained already are only measured, if at all."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Run whose R_mean all variants have."""
    cache: Path = Path("runs/ablation")
    """Folder of the trainings and of one record for each variant."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    variants: tuple[str, ...] = tuple(VARIANTS)
    """Which to train; the table has all that are in the cache."""
    fabric: str = "gray-interlock"
    """Fabric."""
    stage: StageOptions = field(
        default_factory=lambda: StageOptions(
            LoopOptions(steps=400, optimiser="muon", learning_rate=1e-2, warmup=100, evaluate_every=200)
        )
    )
    """Of R_smooth, the same for all."""
    fine_steps: int = 300
    """Steps of R_fine."""
    measured_garments: int = 6
    """Garments of each case that are measured, evenly spread; 0 for all."""
    measured_shapes: int = 8
    """Test shapes of each, evenly spread; those in the block and along the first beta are always measured."""


def main(config: Config) -> None:
    """Train the variants one after the other, measure each, then print, draw and store the table."""
    unknown = [name for name in config.variants if name not in VARIANTS]
    if unknown:
        raise ValueError(f"unknown variants {', '.join(unknown)}; known: {', '.join(VARIANTS)}")
    manifest, dataset = load_manifest(), read_config(config.data)
    start = _start(config)
    names = training_names(config.data, manifest)
    cases = {case: _some(group, config.measured_garments) for case, group in case_names(config.data, manifest).items()}
    read = {name: variant_garments(VARIANTS[name], names, manifest) for name in ("base", *config.variants)}
    loaded = _Loaded(start, config.data, read, [n for group in cases.values() for n in group])
    garments = loaded("base")
    shared = {
        "options": options_record(config.stage, config.fine_steps),
        "mean": hash_arrays(*start.mean.mlp.weights, *start.mean.mlp.biases),
        "fabric": config.fabric,
    }
    evaluated = {
        "measured": dataset_checksum(config.data, [n for group in cases.values() for n in group]),
        "shapes": config.measured_shapes,
    }
    for name in config.variants:
        variant, folder = VARIANTS[name], config.cache / name
        seen = variant_garments(variant, names, manifest)
        if variant.additional and not set(seen) - set(variant_garments(VARIANTS["base"], names, manifest)):
            print(f"{name}: no additional design is simulated, left out")
            continue
        identity = {**shared, "data": dataset_checksum(config.data, seen)}
        record = _read(folder / "trained.json", identity)
        if record is None:
            known = loaded(name)
            model, record = train_variant(
                variant,
                start,
                [known[n] for n in seen],
                manifest,
                config.fabric,
                config.data,
                folder,
                config.stage,
                config.fine_steps,
                identity["data"],
            )
            save_model(folder / "model.safetensors", model)
            write_text(folder / "trained.json", json.dumps(record | {"identity": identity}, indent=1) + "\n")
        identity |= evaluated
        if _read(folder / "result.json", identity) is None:
            model = load_model(folder / "model.safetensors")
            known = loaded(name)
            measured = {case: [known[n] for n in group] for case, group in cases.items()}
            record |= {"samples_mm": measure_variant(variant, model, measured, config.fabric, config.measured_shapes)}
            write_text(folder / "result.json", json.dumps(record | {"identity": identity}, indent=1) + "\n")
            print(f"{name}: {summarise(record['samples_mm'])}", flush=True)
    records = {}
    for name in VARIANTS:
        seen = variant_garments(VARIANTS[name], names, manifest)
        identity = {**shared, "data": dataset_checksum(config.data, seen), **evaluated}
        if (record := _read(config.cache / name / "result.json", identity)) is not None:
            records[name] = record
    results = {
        "fabric": config.fabric,
        "block": BLOCK,
        "fabrics": dataset.fabrics,
        "variants": {
            name: {
                "title": VARIANTS[name].title,
                **{key: record[key] for key in ("parameters", "garments", "samples")},
                "seconds": record["smooth"]["seconds"] + record.get("fine", {}).get("seconds", 0.0),
                "errors": summarise(record["samples_mm"]),
            }
            for name, record in records.items()
        },
        # The kNN knows the designs that the base variant is trained on.
        "baselines": measure_baselines(
            config,
            start,
            {case: [garments[n] for n in group] for case, group in cases.items()},
            manifest,
            read["base"],
        ),
    }
    publish(config, "ablation", results, markdown, draw, garments=garments)


class _Loaded:
    """Garments as a variant's networks see them: one whose Laplacian is another has other graphs."""

    def __init__(
        self, start: TryOnModel, root: Path, read: Mapping[str, Sequence[str]], measured: Sequence[str]
    ) -> None:
        self.start, self.root, self.read, self.measured = start, root, read, measured
        self._known: dict[str, dict[str, SimulatedGarment]] = {}

    def __call__(self, variant: str) -> dict[str, SimulatedGarment]:
        """All that the variant is trained or measured on."""
        normalisation = variant_config(VARIANTS[variant], self.start.config).laplacian
        known = self._known.setdefault(normalisation, {})
        if missing := sorted({*self.read[variant], *self.measured} - set(known)):
            model = replace(self.start, config=replace(self.start.config, laplacian=normalisation))
            known |= load_all(model, self.root, missing)
        return known


def _start(config: Config) -> TryOnModel:
    """The configuration `small` with the run's R_mean and one fabric."""
    model = load_model(model_path(config.run))
    same = (
        "body",
        "layout",
        "parameters",
        "template_vertices",
        "target_area",
        "mean_hidden",
        "num_betas",
        "num_joints",
    )
    changes = {name: getattr(model.config, name) for name in same}
    small = load_config("small", **changes, fabrics=(config.fabric,))
    return replace(init_model(jax.random.key(0), small, body=model.body), mean=model.mean)


def _some(names: Sequence[str], most: int) -> list[str]:
    return [names[int(k)] for k in spread(len(names), most)]


def _read(path: Path, identity: Mapping[str, Any]) -> dict[str, Any] | None:
    """A variant's record, or None where there is none or it belongs to other options or data."""
    if not path.exists():
        return None
    record = json.loads(path.read_text())
    return record if record["identity"] == json.loads(json.dumps(identity)) else None


def measure_baselines(
    config: Config,
    model: TryOnModel,
    cases: Mapping[str, Sequence[SimulatedGarment]],
    manifest: Manifest,
    names: Sequence[str],
) -> dict[str, dict[str, Any]]:
    """The same numbers for predictions without learning, on the same samples."""
    known = [load_drapes(model, config.data, n, config.fabric) for n in tqdm(names, desc="kNN", mininterval=2)]
    chosen = {}
    for case, group in cases.items():
        for samples in group:
            rows = held_out_rows(samples, [config.fabric])
            special = in_block(samples.betas[rows]) | along_first(samples.betas[rows])
            chosen[case, samples.name] = np.union1d(rows[special], rows[spread(len(rows), config.measured_shapes)])
    betas = np.unique(np.concatenate([s.betas[chosen[c, s.name]] for c, group in cases.items() for s in group]), axis=0)
    neighbours = NearestGarments(known, manifest, betas)
    found: dict[str, dict[str, list[dict[str, Any]]]] = {row: {case: [] for case in cases} for row in BASELINES}
    for case, group in cases.items():
        for samples in group:
            rows, count = chosen[case, samples.name], samples.garment.num_vertices
            if not len(rows):
                continue
            mean = samples.garment.mean_vertices
            simulated = samples.drapes[config.fabric][rows, :count]
            drapes = {
                "mean drape": np.broadcast_to(mean[None], simulated.shape),
                "transfer": transfer(model, mean, samples.betas[rows]),
                "neighbours": neighbours(samples, rows, with_design=False),
                "neighbours, design": neighbours(samples, rows, with_design=True),
            }
            for row, drape in drapes.items():
                errors = (1e3 * vertex_distances(drape, simulated).mean(axis=1)).tolist()
                entry = {"name": samples.name, "betas": samples.betas[rows].tolist()}
                found[row][case].append({**entry, "smooth_mm": errors, "fine_mm": errors})
    return {row: {"title": BASELINES[row], "errors": summarise(samples_mm)} for row, samples_mm in found.items()}


def summarise(samples_mm: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, dict[str, float | None]]:
    """Means over samples for each case: all of them, R_smooth alone, the block, the first beta, the ends of rays."""
    summary = {}
    for case, entries in samples_mm.items():
        if not entries:
            continue
        betas = np.concatenate([np.asarray(entry["betas"]) for entry in entries])
        fine, smooth = (np.concatenate([entry[key] for entry in entries]) for key in ("fine_mm", "smooth_mm"))
        parts = {
            "mean_mm": np.ones(len(betas), bool),
            "block_mm": in_block(betas),
            "outside_block_mm": ~in_block(betas),
            "first_beta_mm": along_first(betas),
            "ends_mm": ray_ends(betas),
        }
        summary[case] = {key: float(fine[rows].mean()) if rows.any() else None for key, rows in parts.items()}
        summary[case] |= {"smooth_mm": float(smooth.mean()), "samples": len(betas)}
        if folds := [entry["folds"] for entry in entries if entry.get("folds")]:
            summary[case] |= dict(zip(("folds", "correlation"), np.mean(folds, axis=0).tolist(), strict=True))
    return summary


def markdown(results: Mapping[str, Any]) -> list[str]:
    """The table, and what the held-out block and the single beta cost."""
    variants, baselines = results["variants"], results["baselines"]
    lines = [
        f"R_smooth and R_fine for {results['fabric']}, without kriged drapes, as many steps for every variant, far "
        "fewer than the shipped weights had: differences between rows matter, not their size. One seed each: small "
        "differences say little. Error of M_fine, mean per vertex on test shapes, mm. Folds: energy of those that vary "
        "with the body over that of the simulation, and how they correlate with it, on unseen designs. Minutes on a "
        "machine that did other work too. In the paper's form (betas at each node, no waves, no design, symmetric "
        "Laplacian) each body is a pass: its networks are narrower and see 4 bodies of a garment in place of 16.",
        "",
        "| variant | " + " | ".join(CASES.values()) + " | folds (correlation) | M_smooth alone (trained designs) | "
        "parameters | training samples | minutes |",
        "|---|" + "---|" * (len(CASES) + 5),
    ]
    for entry in variants.values():
        cells = [_number(entry["errors"].get(case, {}).get("mean_mm")) for case in CASES]
        smooth = _number(entry["errors"].get("as trained", {}).get("smooth_mm"))
        unseen = entry["errors"].get("unseen design", {})
        folds = f"{_number(unseen.get('folds'))} ({_number(unseen.get('correlation'))})"
        lines.append(
            f"| {entry['title']} | {' | '.join(cells)} | {folds} | {smooth} | {entry['parameters']:,} | "
            f"{entry['samples']:,} | {entry['seconds'] / 60:.1f} |"
        )
    for entry in baselines.values():
        cells = [_number(entry["errors"].get(case, {}).get("mean_mm")) for case in CASES]
        lines.append(f"| {entry['title']} | {' | '.join(cells)} | – | – | 0 | – | – |")
    if "base" in variants and "one-beta" in variants:
        both = [variants[name]["errors"].get("as trained", {}).get("first_beta_mm") for name in ("one-beta", "base")]
        lines += [
            "",
            "One against two betas, on test shapes along the first: "
            f"{_number(both[0])} mm trained along it alone, {_number(both[1])} mm trained on both.",
        ]
    if (held := block_ratio(results)) is not None:
        low, high = np.array(results["block"]).T
        verdict = "reached" if held["ratio"] <= AIM else "not reached"
        lines += [
            "",
            f"Held-out block, betas ({', '.join(f'{b:g}' for b in low)}) to ({', '.join(f'{b:g}' for b in high)}): "
            f"{held['held_out_mm']:.2f} mm inside when never trained there, {held['trained_mm']:.2f} mm inside when "
            f"trained there, {held['mean_mm']:.2f} mm on all test shapes. At most {AIM:g} × the mean: {verdict} "
            f"({held['ratio']:.2f}).",
        ]
    return lines


def block_ratio(results: Mapping[str, Any]) -> dict[str, float] | None:
    """Error in the block when it was held out, when it was not, and over all test shapes of trained designs."""
    held, base = (results["variants"].get(name, {}).get("errors", {}) for name in ("held-out-block", "base"))
    values = (
        held.get("as trained", {}).get("block_mm"),
        base.get("as trained", {}).get("block_mm"),
        held.get("as trained", {}).get("mean_mm"),
    )
    if any(value is None for value in values):
        return None
    return {"held_out_mm": values[0], "trained_mm": values[1], "mean_mm": values[2], "ratio": values[0] / values[2]}


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def draw(path: Path, results: Mapping[str, Any]) -> None:
    """Bars of the error of each variant and baseline by case."""
    from matplotlib.figure import Figure

    entries = [*results["variants"].values(), *results["baselines"].values()]
    cases = [case for case in CASES if any(case in entry["errors"] for entry in entries)]
    figure = Figure(figsize=(9, 1.0 + 0.42 * len(entries)), dpi=90, layout="constrained")
    axis = figure.subplots()
    height = 0.8 / max(len(cases), 1)
    for number, case in enumerate(cases):
        values = [entry["errors"].get(case, {}).get("mean_mm") or 0.0 for entry in entries]
        at = np.arange(len(entries)) + (number - (len(cases) - 1) / 2) * height
        bars = axis.barh(at, values, 0.92 * height, label=CASES[case])
        axis.bar_label(bars, [f"{v:.1f}" for v in values], padding=3, fontsize=6)
    axis.axhline(len(results["variants"]) - 0.5, color="0.6", linewidth=0.8)
    axis.set_yticks(np.arange(len(entries)), [entry["title"] for entry in entries], fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("mm from the simulation, test shapes (below the line: no learning)")
    axis.legend(fontsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
