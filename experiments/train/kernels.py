"""Which kernel, how many components and how many designs make the best kriged drapes.

Every variant is fitted in seconds. Choices are made on validation shapes and designs; test samples are not read.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.shared.record import RESULTS, publish
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.training.dataset import default_root, read_config
from tryon_jax.training.kriging import KrigingFit
from tryon_jax.training.node_drapes import NodeDrapes, read_nodes
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.training_set import load_samples, training_names
from tryon_jax.tryon import load_model

VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "length over designs 0.7": {"design": 0.7},
    "length over designs 1.5": {"design": 1.5},
    "length over shapes 0.7": {"shape": 0.7},
    "length over shapes 1.5": {"shape": 1.5},
    "nugget 0.005": {"nugget": 0.005},
    "nugget 0.05": {"nugget": 0.05},
    "300 designs": {"designs": 300},
    "900 designs": {"designs": 900},
    "32 shapes": {"shapes": 32},
    "64 shapes": {"shapes": 64},
    "2,000 functions": {"functions": 2000},
    "8,000 functions": {"functions": 8000},
    "112 components": {"components": 112},
    "320 components": {"components": 320},
}
"""What differs from the default."""
DESIGNS = (0, 50, 100, 200, 400, 700, 1000)
"""Numbers of additional designs, the first ones, that the default kernel is fitted to."""


@dataclass(frozen=True)
class Config:
    """What to try."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Run whose R_mean is used."""
    out: Path = RESULTS
    """Folder for the record."""
    kriging: KrigingConfig = field(default_factory=KrigingConfig)
    """What the variants differ from."""


def main(config: Config) -> None:
    """Fit every variant, then print and store the tables."""
    manifest, fabrics = load_manifest(), read_config(config.data).fabrics
    model = load_model(model_path(config.run))
    names = training_names(config.data, manifest)
    samples = load_samples(model, config.data, names)
    kernels: dict[str, dict[str, list[float]]] = {name: {} for name in VARIANTS}
    designs: dict[str, dict[str, list[float]]] = {}
    for fabric in fabrics:
        fitted = read_nodes(model, samples, manifest, fabric)
        held = read_nodes(model, samples, manifest, fabric, "validation")
        for name, changes in VARIANTS.items():
            kernels[name][fabric] = errors(KrigingFit(fitted, replace(config.kriging, **changes)), held, manifest)
        for count in DESIGNS:
            some = {design.label for design in (*manifest.training, *manifest.additional[:count])}
            kept = fitted.only([name for name in fitted.rows if name.rsplit("-", 1)[0] in some])
            fit = KrigingFit(kept, config.kriging)
            designs.setdefault(str(count), {})[fabric] = [*errors(fit, held, manifest), len(kept.rows)]
    results = {"default": asdict(config.kriging), "kernels": kernels, "designs": designs}
    publish(config, "kernels", results, markdown, garments=names)


def errors(fit: KrigingFit, held: NodeDrapes, manifest: Manifest) -> list[float]:
    """Mean distance at the nodes, mm: on validation designs, and on validation shapes of designs that are fitted."""
    off = np.linalg.norm((fit.predict(held) - held.fields).reshape(len(held.fields), -1, 3), axis=2).mean(axis=1)
    groups: dict[bool, list[float]] = {True: [], False: []}
    for name, rows in held.rows.items():
        groups[name.rsplit("-", 1)[0] in manifest.validation].append(1e3 * float(off[rows].mean()))
    return [float(np.mean(values)) if values else float("nan") for values in groups.values()]


def markdown(results: Mapping[str, Any]) -> list[str]:
    """Both tables."""
    fabrics = list(next(iter(results["kernels"].values())))
    heads = " | ".join(f"{fabric}: new designs · new shapes, mm" for fabric in fabrics)
    lines = [f"| kernel | {heads} |", "|---|" + "---|" * len(fabrics)]
    for name, row in results["kernels"].items():
        lines.append(f"| {name} | " + " | ".join("{:.2f} · {:.2f}".format(*row[f][:2]) for f in fabrics) + " |")
    lines += ["", f"| additional designs | {heads} |", "|---|" + "---|" * len(fabrics)]
    for count, row in results["designs"].items():
        lines.append(f"| {count} | " + " | ".join("{:.2f} · {:.2f}".format(*row[f][:2]) for f in fabrics) + " |")
    kept = results["default"]
    note = (
        f"Default: lengths {kept['design']} half ranges of a parameter and {kept['shape']} half axes of the body "
        f"shapes, nugget {kept['nugget']}, {kept['functions']} products of functions at {kept['designs']} designs and "
        f"{kept['shapes']} shapes, {kept['components']} components. New designs are "
        "not fitted and choose the kernel, like the new shapes of fitted designs. Additional designs come on top of "
        "the paper's 19; in a fabric there are fewer of them where one could not be put on."
    )
    return [*lines, "", note]
