"""Describe a simulated dataset: what was kept and why not, distributions of its statistics, pictures of its drapes."""

import json
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from experiments.shared.figures import dressed_cell
from experiments.shared.record import describe_dataset, write_result
from measuring.records import environment, table
from tryon_jax.body import load_body, shape_body
from tryon_jax.checks import check_range
from tryon_jax.files.atomic import atomic_path, write_text
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.render import SheetItem, contact_sheet
from tryon_jax.training.dataset import RULES, STATISTICS, default_root, is_good, load_arrays, mesh_path, read_config
from tryon_jax.training.samples import Sample, manifest_table, read_samples

LABELS = {
    "residual": "net force / (weight + contact load)",
    "steps": "solver steps",
    "depth": "deepest sample inside the body, mm",
    "inside": "samples inside the body, %",
    "self_intersections": "self-intersecting faces, %",
    "tension": "tension (95th percentile), N/m",
    "stretch": "stretch (99th percentile)",
}
SCALES = {"depth": 1e3, "inside": 100.0, "self_intersections": 100.0}
FABRIC_COLORS = ((0.29, 0.43, 0.58), (0.72, 0.42, 0.34), (0.40, 0.55, 0.38), (0.62, 0.54, 0.30))


@dataclass(frozen=True)
class Config:
    """What to report on."""

    data: Path = field(default_factory=default_root)
    """Folder of the dataset."""
    out: Path = Path("dataset-report")
    """Folder for report.md, report.json, samples.csv and the pictures."""
    record: Path | None = None
    """Folder for a short record that `experiments report` reads; by default none is written."""
    pictures: bool = True
    """Draw contact sheets (seconds for each drape)."""
    shapes: int = 4
    """Body shapes on each design's row: the mean one, then the ends of the first rays."""
    worst: int = 12
    """Drapes on the sheet of the worst kept ones, and of excluded ones."""
    height: int = 420
    """Pixels of each drape."""


def main(config: Config) -> None:
    """Write the report."""
    check_range("shapes", config.shapes, 1, 200)
    root, out = config.data.expanduser(), config.out.expanduser()
    dataset = read_config(root)
    samples = read_samples(root)
    if not samples:
        raise ValueError(f"the dataset at {str(root)!r} holds no drape yet")
    report: dict[str, Any] = {
        "environment": environment(),
        "dataset": {k: str(v) for k, v in vars(dataset).items()},
        "samples": len(samples),
        "kept": sum(not s.broken_rules() for s in samples),
        "parts": count_parts(samples, load_manifest()),
        "by_design": count_rules(samples),
        "percentiles": percentiles(samples),
        "along_rays": smoothness(root, dataset.fabrics),
    }
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "report.json", json.dumps(report, indent=2) + "\n")
    write_text(out / "report.md", as_markdown(report))
    write_text(out / "samples.csv", manifest_table(root, samples, load_manifest()))
    print(as_markdown(report))
    plot_histograms(out / "histograms.png", samples, dataset.fabrics)
    plot_kept(out / "kept.png", report["by_design"])
    if config.record is not None:
        garments = sorted({sample.garment for sample in samples})
        results = {key: report[key] for key in ("samples", "kept", "parts", "percentiles", "along_rays")}
        write_result(config.record, "dataset_report", config, results, dataset=describe_dataset(root, garments))
        plot_histograms(config.record / "dataset_report.png", samples, dataset.fabrics)
    if config.pictures:
        draw_sheets(config, root, samples, dataset.body, dataset.fabrics)


def count_parts(samples: list[Sample], manifest: Manifest) -> list[dict[str, Any]]:
    """For each part of the dataset: its garments, the directions of body shape it covers, drapes, and how many stay.

    `whole directions` are rays that every garment of the part has in every fabric.
    """
    training = {design.label for design in manifest.training}
    additional = {design.label for design in manifest.additional}

    def part(sample: Sample) -> str:
        if sample.design in additional:
            return "additional designs"
        if sample.design not in training:
            return "unseen designs"
        return "training designs" if sample.seed in manifest.training_seeds else "unseen topologies"

    groups: dict[str, list[Sample]] = defaultdict(list)
    for sample in samples:
        groups[part(sample)].append(sample)
    rows = []
    for name in ("training designs", "additional designs", "unseen designs", "unseen topologies"):
        group = groups.get(name, [])
        if not group:
            continue
        rays: dict[tuple[str, str], set[str]] = {(s.garment, s.fabric): set() for s in group}
        for sample in group:
            if sample.row is not None:
                rays[sample.garment, sample.fabric].add(sample.path.stem.split("_")[2])
        row: dict[str, Any] = {"part": name, "designs": len({s.design for s in group})}
        row |= {"garments": len({s.garment for s in group}), "fabrics": len({s.fabric for s in group})}
        row |= {"whole directions": len(set.intersection(*rays.values())), "drapes": len(group)}
        row["kept"] = sum(not s.broken_rules() for s in group)
        rows.append(row | {"for tests, of the kept": sum(s.test and not s.broken_rules() for s in group)})
    return rows


def markdown(results: dict[str, Any]) -> list[str]:
    """Section of docs/RESULTS.md."""
    kept = [{k: v for k, v in row.items() if k != "of"} for row in results["percentiles"] if row["of"] == "kept"]
    share = 100 * results["kept"] / results["samples"]
    return [
        f"{results['samples']} drapes, {share:.1f} % kept by the rules ({rules()}). A tension above its rule marks "
        "what real cloth could not be pulled over. Shapes between the training shapes are for tests.",
        "",
        table(results["parts"]),
        "",
        "Of the kept drapes:",
        "",
        table(kept),
        *(("", "Along the rays, kept neighbours:", "", table(rows)) if (rows := results["along_rays"]) else ()),
    ]


def rules() -> str:
    """The rules in words."""
    return ", ".join(f"{key} ≤ {limit:g}" for key, limit in RULES.items())


def count_rules(samples: list[Sample]) -> list[dict[str, Any]]:
    """For each design and fabric: drapes, kept ones, and how many break each rule (some break several)."""
    groups: dict[tuple[str, str], list[Sample]] = defaultdict(list)
    for sample in samples:
        groups[sample.design, sample.fabric].append(sample)
    rows = []
    for (design, fabric), group in sorted(groups.items()):
        broken = [sample.broken_rules() for sample in group]
        row: dict[str, Any] = {"design": design, "fabric": fabric, "drapes": len(group)}
        row["kept"] = sum(not rules for rules in broken)
        rows.append(row | {key: sum(key in rules for rules in broken) for key in RULES})
    return rows


def percentiles(samples: list[Sample]) -> list[dict[str, Any]]:
    """Distribution of each statistic by fabric, among all drapes and among those kept."""
    rows = []
    for fabric in sorted({sample.fabric for sample in samples}):
        for kept in (False, True):
            group = [s for s in samples if s.fabric == fabric and (not kept or not s.broken_rules())]
            for key in STATISTICS:
                values = np.array([s.statistics[key] for s in group]) * SCALES.get(key, 1.0)
                # Shapes whose simulation was lost have no finite statistics; the table of rules counts them.
                values = values[np.isfinite(values)]
                if not len(values):
                    continue
                low, middle, high, top = (float(v) for v in np.percentile(values, [5, 50, 95, 100]))
                of = "kept" if kept else "all"
                row = {"fabric": fabric, "of": of, "statistic": LABELS[key], "5 %": low, "50 %": middle}
                rows.append(row | {"95 %": high, "largest": top})
    return rows


def smoothness(root: Path, fabrics: tuple[str, ...]) -> list[dict[str, Any]]:
    """How much kept drapes move between neighbouring shapes of a ray, and how far from evenly: noise of the labels."""
    rows = []
    for fabric in fabrics:
        first, second = [], []
        for path in sorted((root / "rays").glob(f"[!.]*_{fabric}_*.npz")):
            arrays = load_arrays(path)
            vertices, good = arrays["vertices"], is_good(arrays)
            step = np.linalg.norm(np.diff(vertices, axis=0), axis=2).mean(axis=1)
            bend = np.linalg.norm(vertices[2:] - 2 * vertices[1:-1] + vertices[:-2], axis=2).mean(axis=1)
            first.append(step[good[1:] & good[:-1]])
            second.append(bend[good[2:] & good[1:-1] & good[:-2]])
        if not first or not len(np.concatenate(second)):
            continue
        step, bend = 1e3 * np.concatenate(first), 1e3 * np.concatenate(second)
        row = {"fabric": fabric, "motion per shape, mm": float(step.mean())}
        row |= {"second difference, mm": float(bend.mean()), "its 95 %": float(np.percentile(bend, 95))}
        rows.append(row | {"its largest": float(bend.max())})
    return rows


def as_markdown(report: dict[str, Any]) -> str:
    """The report as text."""
    share = 100 * report["kept"] / report["samples"]
    parts = [
        f"# Dataset of {report['samples']} drapes, {share:.1f} % kept",
        f"Rules: {rules()}.",
        "## Parts",
        table(report["parts"]),
        "## Kept and excluded, by design and fabric",
        table(report["by_design"]),
        "## Statistics",
        table(report["percentiles"]),
    ]
    if report["along_rays"]:
        parts += ["## Along rays (kept neighbours)", table(report["along_rays"])]
    return "\n\n".join(parts) + "\n"


def plot_histograms(path: Path, samples: list[Sample], fabrics: tuple[str, ...]) -> None:
    """One panel for each statistic, fabrics beside each other, the rule as a line."""
    import matplotlib.pyplot as plt
    from matplotlib.patches import Rectangle

    figure, axes = plt.subplots(2, 4, figsize=(16, 7), constrained_layout=True)
    for axis, key in zip(axes.flat, STATISTICS, strict=False):
        scale = SCALES.get(key, 1.0)
        groups = [
            [v for s in samples if s.fabric == fabric and np.isfinite(v := scale * s.statistics[key])]
            for fabric in fabrics
        ]
        top = max(np.percentile(group, 99.5) for group in groups if group)
        low = min(min(group) for group in groups if group)
        axis.hist([np.clip(group, low, top) for group in groups], bins=40, color=FABRIC_COLORS[: len(fabrics)])
        axis.set_xlabel(LABELS[key])
        axis.set_yscale("log")
        if key in RULES:
            axis.axvline(scale * RULES[key], color="black", linestyle="--", linewidth=1)
    axes.flat[len(STATISTICS)].axis("off")
    handles = [Rectangle((0, 0), 1, 1, color=color) for color in FABRIC_COLORS[: len(fabrics)]]
    axes.flat[len(STATISTICS)].legend(handles, fabrics, loc="center", title="fabric (dashed: rule)")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)
    plt.close(figure)


def plot_kept(path: Path, rows: list[dict[str, Any]]) -> None:
    """Share of kept drapes, designs against fabrics."""
    import matplotlib.pyplot as plt

    designs = sorted({row["design"] for row in rows})
    fabrics = sorted({row["fabric"] for row in rows})
    share = np.full((len(designs), len(fabrics)), np.nan)
    for row in rows:
        share[designs.index(row["design"]), fabrics.index(row["fabric"])] = 100 * row["kept"] / row["drapes"]
    figure, axis = plt.subplots(figsize=(3 + 1.6 * len(fabrics), 1.2 + 0.3 * len(designs)), constrained_layout=True)
    picture = axis.imshow(share, vmin=0, vmax=100, cmap="RdYlGn", aspect="auto")
    axis.set_xticks(range(len(fabrics)), fabrics)
    axis.set_yticks(range(len(designs)), designs)
    for (i, j), value in np.ndenumerate(share):
        axis.text(j, i, "" if np.isnan(value) else f"{value:.0f}", ha="center", va="center")
    figure.colorbar(picture, label="kept, %")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)
    plt.close(figure)


def draw_sheets(config: Config, root: Path, samples: list[Sample], body_name: str, fabrics: tuple[str, ...]) -> None:
    """Contact sheets: designs x shapes for each fabric, the worst kept drapes, and excluded ones."""
    body = load_body(body_name)

    def item(sample: Sample, title: str) -> SheetItem:
        skin = np.asarray(shape_body(body, jnp.asarray(sample.betas, jnp.float32))[0])
        faces = load_arrays(mesh_path(root, sample.garment))["faces"]
        color = FABRIC_COLORS[fabrics.index(sample.fabric) % len(FABRIC_COLORS)]
        garment = (sample.vertices(), faces)
        return dressed_cell(body, skin, garment, title, color)

    def name(sample: Sample) -> str:
        rules = sample.broken_rules()
        betas = ", ".join(f"{b:+.1f}" for b in sample.betas)
        return f"{sample.garment} ({betas})" + (f" OUT: {', '.join(rules)}" if rules else "")

    out = config.out.expanduser()
    for fabric in fabrics:
        chosen: list[Sample] = []
        for design in sorted({s.design for s in samples if s.fabric == fabric}):
            of_design = [s for s in samples if s.design == design and s.fabric == fabric]
            garment = of_design[0].garment
            mine = [s for s in of_design if s.garment == garment]
            mean = [s for s in mine if s.row is None][:1]
            ends = {s.path: s for s in mine if s.row is not None}
            chosen += (mean + list(ends.values()))[: config.shapes]
        items = [item(s, name(s)) for s in chosen]
        contact_sheet(out / f"drapes-{fabric}.png", items, columns=2 * config.shapes, height=config.height, crop="body")
    kept = [s for s in samples if not s.broken_rules()]
    # The same number of the worst of each rule, without repeats.
    worst: dict[int, Sample] = {}
    for key in RULES:
        ranked = sorted(kept, key=lambda s, key=key: -s.statistics[key])
        for sample in ranked[: -(-config.worst // len(RULES))]:
            worst[id(sample)] = sample
    if worst:
        items = [item(s, f"{name(s)} {s.fabric}") for s in worst.values()]
        contact_sheet(out / "worst-kept.png", items, views=("front", "side"), height=config.height)
    excluded = [s for s in samples if s.broken_rules()]
    if excluded:
        step = max(1, len(excluded) // config.worst)
        items = [item(s, name(s)) for s in excluded[::step][: config.worst]]
        contact_sheet(out / "excluded.png", items, views=("front", "side"), height=config.height)
