"""The fully connected alternative: one dense mesh for all garments, measured on unseen designs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments.paper.dense_network import DenseMeshes, DenseNetwork, load_samples, train_dense
from experiments.paper.memory import PAPER_MEGABYTES, dense_bytes, dense_layers
from experiments.shared.evaluate import Pipeline, available, case_names, held_out_rows, load_all, open_model, spread
from experiments.shared.record import RESULTS, publish
from tryon_jax.files.atomic import atomic_path
from tryon_jax.garment.dense import DENSE_VERTICES
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.metrics import hausdorff_distance, vertex_distances
from tryon_jax.nets.store import hash_arrays, read_record
from tryon_jax.nets.unet import count_parameters
from tryon_jax.training.dataset import default_root
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.loop import LoopOptions
from tryon_jax.training.protocol import EXTENT
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.training_set import dataset_checksum

METHODS = ("ours", "fully connected")


@dataclass(frozen=True)
class Config:
    """What to train and compare; a stopped training continues."""

    data: Path = field(default_factory=default_root)
    """Folder of the simulated dataset."""
    run: Path = Path("runs/small")
    """Folder of the run that it is compared with, and whose R_mean gives the mean drape of both."""
    cache: Path = Path("runs/fully-connected")
    """Folder of the baseline's checkpoint (four times its weights)."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    fabric: str = "gray-interlock"
    """Fabric; the baseline would be trained anew for another."""
    megabytes: float = PAPER_MEGABYTES["fully connected"]
    """Weights of the baseline in float32, as in the paper: decides the hidden layer's width."""
    vertices: int = DENSE_VERTICES
    """Vertices of the dense mesh, as in the paper."""
    loop: LoopOptions = field(
        default_factory=lambda: LoopOptions(steps=2000, learning_rate=5e-3, warmup=50, evaluate_every=200)
    )
    batch: int = 32
    """Samples in a mini-batch."""
    shapes: int = 12
    """Test shapes of each design, evenly spread; 0 for all."""
    trained: int = 6
    """Training garments that are measured beside the unseen designs, evenly spread; 0 for all."""
    train_only: bool = False
    """Stop after the training, which needs no other stage of the run than R_mean."""
    untrained: bool = False
    """Run with stages that are not trained, to try the experiment out."""


def main(config: Config) -> None:
    """Train the baseline, then measure both on unseen designs and on trained ones."""
    manifest = load_manifest()
    weights = model_path(config.run)
    model = open_model(weights, config.untrained or config.train_only, (config.fabric,))
    cases = case_names(config.data, manifest)
    # All that the graph networks may have seen, the additional designs among them where they are simulated.
    names = available(config.data, manifest.training_garments())
    meshes = DenseMeshes(model, manifest, config.vertices)
    inputs = len(manifest.space.names) + model.config.num_betas
    layers = dense_layers(config.megabytes, inputs, 3 * config.vertices)
    print(f"fully connected {layers}: {dense_bytes(layers):,} bytes in float32")
    identity = {
        "fabric": config.fabric,
        "dataset": dataset_checksum(config.data, names),
        "mean": hash_arrays(*model.mean.mlp.weights, *model.mean.mlp.biases),
    }
    samples = load_samples(meshes, config.data, names, config.fabric)
    network, result = train_dense(samples, layers, config.cache, config.loop, config.batch, identity)
    if config.train_only:
        print(f"trained to {min(row['validation'] for row in result.curve):.2f} mm on validation shapes")
        return
    measured = {
        "unseen": cases["unseen design"],
        "trained": [cases["as trained"][k] for k in spread(len(cases["as trained"]), config.trained)],
    }
    garments = load_all(model, config.data, [n for group in measured.values() for n in group])
    pipeline = Pipeline(model)
    found = {
        case: [
            measure(garments[n], pipeline, network, meshes, config)
            for n in tqdm(group, desc=f"{case} designs", mininterval=2)
        ]
        for case, group in measured.items()
    }
    results = {
        "layers": layers,
        "bytes": {
            "fully connected": dense_bytes(layers),
            "ours": 4
            * count_parameters((model.kriging.get(config.fabric, model.smooth.net), model.fine[config.fabric].net)),
        },
        "training": {
            "samples": sum(len(s.train) for s in samples),
            "garments": len(samples),
            "steps": result.curve[-1]["step"],
            "seconds": round(result.seconds),
            "curve": result.curve,
            "ours": read_record(weights).get("training", {}).get(f"fine-{config.fabric}", {}).get("samples"),
        },
        "designs": found,
        **summarise(found),
    }
    publish(config, "fully_connected", results, markdown, draw, garments={*names, *garments}, weights=weights)


def measure(
    samples: SimulatedGarment, pipeline: Pipeline, network: DenseNetwork, meshes: DenseMeshes, config: Config
) -> dict[str, Any]:
    """Both methods on the test shapes of one garment: Hausdorff distance, and mean distance at its vertices."""
    rows = held_out_rows(samples, [config.fabric], config.shapes)
    count, faces = samples.garment.num_vertices, samples.garment.faces
    betas, simulated = samples.betas[rows], samples.drapes[config.fabric][rows, :count]
    ours = pipeline(samples, rows, [config.fabric])[config.fabric].fine
    dense = meshes(samples.label)
    theirs = network(dense, betas)
    at_vertices = meshes.back(config.data, samples.name)(theirs)
    entry: dict[str, Any] = {"name": samples.name, "betas": betas, "vertices": count}
    for method, drapes, drape_faces, same in (
        ("ours", ours, faces, ours),
        ("fully connected", theirs, dense.mesh.faces, at_vertices),
    ):
        entry[method] = {
            "hausdorff_mm": [
                1e3 * hausdorff_distance(p, drape_faces, s, faces) for p, s in zip(drapes, simulated, strict=True)
            ],
            "vertex_mm": (1e3 * vertex_distances(same, simulated).mean(axis=1)).tolist(),
        }
    return entry


def summarise(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    """Means over designs, the factor between the methods, and on how many shapes ours is lower."""
    summary: dict[str, Any] = {}
    for case, designs in found.items():
        measured = [entry for entry in designs if len(entry["betas"])]
        if not measured:
            continue
        means = {
            method: {
                key: float(np.mean([np.mean(entry[method][key]) for entry in measured]))
                for key in ("hausdorff_mm", "vertex_mm")
            }
            for method in METHODS
        }
        lower = np.concatenate(
            [np.less(entry["ours"]["hausdorff_mm"], entry["fully connected"]["hausdorff_mm"]) for entry in measured]
        )
        summary[case] = {
            "designs": len(measured),
            "shapes": len(lower),
            "lower": int(lower.sum()),
            "factor": means["fully connected"]["hausdorff_mm"] / means["ours"]["hausdorff_mm"],
            "means": means,
        }
    return {"summary": summary}


def markdown(results: Mapping[str, Any]) -> list[str]:
    """The table of designs with the claim's verdict."""
    layers = " → ".join(str(n) for n in results["layers"])
    training, size = results["training"], results["bytes"]
    lines = [
        f"Fully connected {layers}: {size['fully connected']:,} bytes in float32 (the paper: "
        f"{PAPER_MEGABYTES['fully connected']:.0f} MB), ours {size['ours']:,}. It predicts displacements from the mean "
        "drape at the dense mesh, whose targets are carried over in UV from the simulated meshes; trained by AdamW on "
        f"{training['samples']} samples of {training['garments']} garments, {training['steps']} steps in "
        f"{training['seconds'] / 60:.0f} minutes. Ours learned from {training.get('ours') or 'an unknown number of'} "
        "samples of the same splits, simulated ones and, where such were trained on, carried over ones.",
        "",
        "| design | test shapes | Hausdorff, ours, mm | fully connected, mm | factor | shapes where ours is lower | "
        "mean per vertex, ours · fully connected, mm |",
        "|---|---|---|---|---|---|---|",
    ]
    for case, designs in results["designs"].items():
        for entry in designs:
            if not len(entry["betas"]):
                lines.append(f"| {entry['name']} ({case}) | 0 | – | – | – | – | – |")
                continue
            one = summarise({case: [entry]})["summary"][case]
            lines.append(_row(f"{entry['name']} ({case})", one))
        if case in results["summary"]:
            lines.append(_row(f"**{case} designs**", results["summary"][case]))
    unseen = results["summary"].get("unseen")
    if unseen is None:
        return [*lines, "", "No unseen design is simulated: not measured."]
    verdict = "supported" if unseen["lower"] == unseen["shapes"] else "not supported"
    return [
        *lines,
        "",
        f"Ours is lower on all unseen designs at every body shape: {verdict} (lower on {unseen['lower']} of "
        f"{unseen['shapes']}; on average by the factor {unseen['factor']:.2f}).",
    ]


def _row(title: str, entry: Mapping[str, Any]) -> str:
    ours, theirs = (entry["means"][method] for method in METHODS)
    return (
        f"| {title} | {entry['shapes']} | {ours['hausdorff_mm']:.1f} | {theirs['hausdorff_mm']:.1f} | "
        f"{entry['factor']:.2f} | {entry['lower']} | {ours['vertex_mm']:.2f} · {theirs['vertex_mm']:.2f} |"
    )


def draw(path: Path, results: Mapping[str, Any]) -> None:
    """Hausdorff distance over body shapes for each unseen design: ours solid blue, the baseline dashed red."""
    from matplotlib.figure import Figure

    designs = [e for e in results["designs"]["unseen"] if len(e["betas"])] or [
        e for e in results["designs"].get("trained", []) if len(e["betas"])
    ]
    columns = min(3, max(1, len(designs)))
    rows = max(1, -(-len(designs) // columns))
    figure = Figure(figsize=(3.6 * columns, 0.5 + 2.6 * rows), dpi=100, layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axis in axes.ravel()[len(designs) :]:
        axis.axis("off")
    for axis, entry in zip(axes.ravel(), designs, strict=False):
        betas = np.asarray(entry["betas"])
        # Rays cross the plane of betas: the distance from the mean body is what all of them share.
        reach = np.linalg.norm(betas / np.array(EXTENT[: betas.shape[1]])[None], axis=1).round(4)
        for method, style, color in (("ours", "-", "tab:blue"), ("fully connected", "--", "tab:red")):
            values = np.asarray(entry[method]["hausdorff_mm"])
            levels = np.unique(reach)
            axis.plot(levels, [values[reach == r].mean() for r in levels], style, color=color, label=method)
            axis.plot(reach, values, ".", color=color, markersize=4, alpha=0.5)
        axis.set_title(entry["name"].rsplit("-", 1)[0], fontsize=9)
        axis.spines[["top", "right"]].set_visible(False)
    # All axes share it; set before the last curve is drawn it would cut off what comes after.
    axes.flat[0].set_ylim(bottom=0)
    for axis in axes[-1]:
        axis.set_xlabel("distance from the mean body, share of the range", fontsize=8)
    for axis in axes[:, 0]:
        axis.set_ylabel("Hausdorff distance, mm", fontsize=8)
    axes[0, 0].legend(fontsize=8)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
