"""Which network and which optimiser learn R_smooth fastest: short trainings that see equally many garments.

Choices are made on validation shapes and designs; test samples are not read.
"""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

from experiments.shared.record import RESULTS, publish
from tryon_jax.files.atomic import atomic_path
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.nets.config import SMALL
from tryon_jax.nets.unet import UNetConfig, count_parameters
from tryon_jax.training.dataset import default_root
from tryon_jax.training.loop import LoopOptions
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.stage_fit import fit_stage
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_sets import smooth_sets
from tryon_jax.training.training_set import dataset_checksum, load_samples, training_names
from tryon_jax.tryon import init_model, load_model


@dataclass(frozen=True)
class Variant:
    """What differs from the first variant."""

    net: UNetConfig = SMALL.smooth
    optimiser: Literal["adamw", "muon"] = "muon"
    learning_rate: float = 1e-2
    bias_rate: float = 0.1
    garments: int = 4
    shapes: int = 16


VARIANTS: dict[str, Variant] = {
    "small": Variant(),
    "4 garments x 4 shapes": Variant(shapes=4),
    "4 garments x 64 shapes": Variant(shapes=64),
    "2 garments x 16 shapes": Variant(garments=2),
    "8 garments x 16 shapes": Variant(garments=8),
    "muon 2e-2": Variant(learning_rate=2e-2),
    "muon 5e-3": Variant(learning_rate=5e-3),
    "biases as fast as matrices": Variant(bias_rate=1.0),
    "adamw 2e-3": Variant(optimiser="adamw", learning_rate=2e-3),
    "adamw 4e-3": Variant(optimiser="adamw", learning_rate=4e-3),
    "order 3": Variant(net=replace(SMALL.smooth, order=3)),
    "layer norm": Variant(net=replace(SMALL.smooth, normalisation="layer")),
    "silu": Variant(net=replace(SMALL.smooth, activation="silu")),
    "half as wide": Variant(net=UNetConfig(widths=(32, 48, 64, 80, 96))),
    "half as wide again": Variant(net=UNetConfig(widths=(96, 144, 192, 240, 288))),
    "narrow first, wide last": Variant(net=UNetConfig(widths=(32, 64, 128, 192, 256))),
    "4 levels": Variant(net=UNetConfig(widths=(64, 96, 128, 160))),
    "3 levels": Variant(net=UNetConfig(widths=(64, 96, 128))),
}


@dataclass(frozen=True)
class Config:
    """What to try; variants that are done already are not trained again."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Run whose R_mean is used."""
    work: Path = Path("runs/sweep")
    """Folder of the trainings."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    steps: int = 300
    """Steps of 4 garments; variants with other batches see as many garments: each is one pass of the network, whatever
    the number of its bodies."""
    garments: int = 10
    """Training garments, evenly spread; the validation designs are always there."""
    variants: tuple[str, ...] = tuple(VARIANTS)
    """Which to train."""


def main(config: Config) -> None:
    """Train each variant, then print, draw and store the table."""
    manifest = load_manifest()
    model = load_model(model_path(config.run))
    names = training_names(config.data, manifest)
    held = [n for n in names if n.rsplit("-", 1)[0] in manifest.validation]
    rest = [n for n in names if n not in held]
    chosen = [rest[i] for i in np.unique(np.linspace(0, len(rest) - 1, config.garments).round().astype(int))] + held
    sets = smooth_sets(load_samples(model, config.data, chosen), manifest)
    rows = []
    for name in config.variants:
        variant = VARIANTS[name]
        options = StageOptions(_loop(variant, config.steps), variant.garments, variant.shapes)
        start = init_model(jax.random.key(0), replace(model.config, smooth=variant.net), body=model.body).smooth
        folder = config.work / name.replace(" ", "-")
        checksum = dataset_checksum(config.data, chosen)
        _, found = fit_stage(model, "smooth", start, sets, folder, options, checksum)
        row = {"variant": name, **asdict(variant), "parameters": count_parameters(start.net)}
        rows.append(row | {key: found[key] for key in ("steps", "seconds", "curve", "validation_mm")})
        print(f"{name}: {rows[-1]['validation_mm']:.2f} mm after {rows[-1]['seconds']:.0f} s", flush=True)
    results = {"variants": rows}
    publish(config, "sweep", results, markdown, draw, garments=chosen)


def _loop(variant: Variant, steps: int) -> LoopOptions:
    total = steps * Variant.garments // variant.garments
    return LoopOptions(
        steps=total,
        optimiser=variant.optimiser,
        learning_rate=variant.learning_rate,
        bias_rate=variant.bias_rate,
        evaluate_every=max(1, total // 3),
    )


def markdown(results: dict[str, Any]) -> list[str]:
    """The table, the best first."""
    rows = sorted(results["variants"], key=lambda row: row["validation_mm"])
    lines = [
        "| variant | parameters | steps | validation, mm | seconds (pauses too) |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {r['variant']} | {r['parameters']:,} | {r['steps']} | {r['validation_mm']:.2f} | {r['seconds']:.0f} |"
        for r in rows
    ]
    note = "One seed each, on a machine that did other work too: small differences in either column say little."
    return [*lines, "", note]


def draw(path: Path, results: dict[str, Any]) -> None:
    """Validation error of each variant, the best one first; the one that the others differ from in another colour."""
    from matplotlib.figure import Figure

    rows = sorted(results["variants"], key=lambda row: row["validation_mm"])
    figure = Figure(figsize=(7, 0.8 + 0.28 * len(rows)), dpi=110, layout="constrained")
    axis = figure.subplots()
    first = next((row["variant"] for row in results["variants"]), "")
    colors = ["tab:orange" if row["variant"] == first else "tab:blue" for row in rows]
    bars = axis.barh([row["variant"] for row in rows], [row["validation_mm"] for row in rows], color=colors)
    axis.bar_label(bars, fmt="%.2f", padding=3, fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("validation error of R_smooth, mm")
    axis.spines[["top", "right"]].set_visible(False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
