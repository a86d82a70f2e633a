"""Bytes of weights beside a fully connected network for all garments, and memory of one drape; `speed` times it."""

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.shared.record import RESULTS, publish
from tryon_jax.nets.config import PAPER, SMALL, TryOnConfig, paper_form
from tryon_jax.nets.unet import count_parameters, init_unet
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import TryOnModel, drape, load_model, prepare

PAPER_MEGABYTES = {"ours": 71.0, "fully connected": 167.0}
DENSE_VERTICES = 17_246
"""Vertices of the paper's mesh for all garments."""
_FLOAT = 4


@dataclass(frozen=True)
class Config:
    """What to measure."""

    out: Path = RESULTS
    """Folder for the record."""
    designs: tuple[str, ...] = ("tshirt", "maxi-dress")
    """Presets that are draped."""
    run: Path = Path("runs/small")
    """Folder of the run whose model drapes them."""


def stage_bytes(config: TryOnConfig) -> int:
    """Bytes of the graph U-Nets of R_smooth and one R_fine in float32; nothing is allocated."""
    parts = (
        (config.smooth, config.smooth_features, config.outputs),
        (config.fine, config.fine_features, config.outputs),
    )
    key = jax.random.key(0)
    # Shapes of leaves alone leave the traced function: modules made of anything but arrays are none.
    leaves = [
        leaf
        for net, features, outputs in parts
        for leaf in jax.eval_shape(lambda k, n=net, f=features, o=outputs: jax.tree.leaves(init_unet(k, n, f, o)), key)
    ]
    return _FLOAT * sum(math.prod(leaf.shape) for leaf in leaves)


def dense_layers(megabytes: float, inputs: int, outputs: int) -> list[int]:
    """Layer sizes of the fully connected network with one hidden layer whose float32 weights reach `megabytes`."""
    hidden = math.ceil((megabytes * 1e6 / _FLOAT - outputs) / (inputs + 1 + outputs))
    return [inputs, hidden, outputs]


def dense_bytes(layers: list[int]) -> int:
    """Bytes of a fully connected network's weights and biases in float32."""
    return _FLOAT * sum(a * b + b for a, b in pairwise(layers))


def main(config: Config) -> None:
    """Count, drape and report."""
    inputs = len(("sleeve_length", "chest", "length")) + SMALL.num_betas
    layers = dense_layers(PAPER_MEGABYTES["fully connected"], inputs, 3 * DENSE_VERTICES)
    model = load_model(model_path(config.run))
    kriged = next(iter(model.kriging), None)
    results: dict[str, Any] = {
        "weights": {
            "kriged": kriged and _FLOAT * count_parameters((model.kriging[kriged], model.fine[kriged])),
            "small": stage_bytes(SMALL),
            "paper": stage_bytes(paper_form(PAPER)),
            "fully connected": dense_bytes(layers),
        },
        "dense_layers": layers,
        "drapes": [_drape(model, design) for design in config.designs],
    }
    publish(config, "memory", results, markdown, weights=model_path(config.run))


def _drape(model: TryOnModel, design: str) -> dict[str, Any]:
    garment = jax.device_put(prepare(model, design))
    betas = jnp.array([1.0, -0.5])
    fabric = model.config.fabrics[0]
    compiled = jax.jit(drape, static_argnames="fabric").lower(model, garment, betas, fabric=fabric).compile()
    analysis = compiled.memory_analysis()
    return {
        "design": design,
        "vertices": garment.num_vertices,
        "working_bytes": None if analysis is None else int(analysis.temp_size_in_bytes),
        "argument_bytes": int(sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves((model, garment)))),
    }


def _kriged_row(size: int | None) -> list[str]:
    return [] if size is None else [f"| kriged drapes and R_fine of a fabric, as in the run | {size / 1e6:.2f} | – |"]


def markdown(results: dict[str, Any]) -> list[str]:
    """Tables with the claim's verdict."""
    weights = results["weights"]
    layers = " → ".join(str(n) for n in results["dense_layers"])
    ratio = weights["fully connected"] / weights["paper"]
    fits = weights["paper"] <= PAPER_MEGABYTES["ours"] * 1e6 and ratio > 1
    lines = [
        "| weights in float32 | MB here | MB in the paper |",
        "|---|---|---|",
        f"| R_smooth + R_fine, configuration `paper` in the paper's form | {weights['paper'] / 1e6:.2f} | "
        f"{PAPER_MEGABYTES['ours']:.0f} |",
        f"| R_smooth + R_fine, configuration `small`, with fields | {weights['small'] / 1e6:.2f} | – |",
        *_kriged_row(weights.get("kriged")),
        f"| fully connected, {layers} | {weights['fully connected'] / 1e6:.2f} | "
        f"{PAPER_MEGABYTES['fully connected']:.0f} |",
        "",
        f"At most 71 MB, and less than the fully connected network: {'supported' if fits else 'not supported'} "
        f"(factor {ratio:.2f}). The paper does not give the fully connected network's layers: one hidden layer of the "
        "width that reaches its size is counted.",
        "",
        "| drape of one body shape | vertices | working memory, MB | arguments, MB |",
        "|---|---|---|---|",
    ]
    for row in results["drapes"]:
        working = "–" if row["working_bytes"] is None else f"{row['working_bytes'] / 1e6:.1f}"
        lines.append(f"| {row['design']} | {row['vertices']} | {working} | {row['argument_bytes'] / 1e6:.1f} |")
    lines += ["", "The section Speed has the time of these drapes."]
    return lines
