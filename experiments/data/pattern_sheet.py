"""Contact sheet of the training designs: each one's panels, and its remeshed front panel in UV; and their table."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from tqdm import tqdm

from measuring.records import environment
from tryon_jax.checks import check_choice
from tryon_jax.files.atomic import atomic_path, write_text
from tryon_jax.garment import load_manifest, remesh
from tryon_jax.garment.panels import draw_panels, draw_triangles


@dataclass(frozen=True)
class Config:
    """Options of the contact sheet."""

    out: Path = Path("artifacts/pattern_sheet.png")
    """Picture to write; the table goes beside it as JSON."""
    split: str = "training"
    """training: the 19 designs; unseen: the 6 of the comparison with the baseline."""
    seed: int = 0
    """Topology that is shown."""
    columns: int = 10
    """Designs in a row."""


def main(config: Config) -> None:
    """Remesh every design, draw the sheet, and write and print the table."""
    from matplotlib.figure import Figure

    check_choice("split", config.split, ("training", "unseen"))
    manifest = load_manifest()
    designs = manifest.training if config.split == "training" else manifest.unseen
    columns = min(config.columns, len(designs))
    bands = -(-len(designs) // columns)
    longest = [max(d["length"] for d in designs[k : k + columns]) for k in range(0, len(designs), columns)]
    # Rows as high as their longest garment, all at one scale.
    heights = [2.0 * length + 0.5 for length in longest for _ in range(2)]
    figure = Figure(figsize=(2.7 * columns, sum(heights) + 0.6), dpi=110, layout="constrained")
    axes = figure.subplots(
        2 * bands, columns, squeeze=False, sharex=True, sharey="row", gridspec_kw={"height_ratios": heights}
    )
    for empty in axes.ravel():
        empty.set_axis_off()
    rows = []
    for k, design in enumerate(tqdm(designs, unit="design")):
        garment = remesh(manifest.space, design, manifest.target_area, seed=config.seed)
        upper, lower = axes[2 * (k // columns), k % columns], axes[2 * (k // columns) + 1, k % columns]
        draw_panels(upper, manifest.space, design)
        draw_triangles(lower, garment, linewidth=0.25)
        sizes = " · ".join(f"{100 * v:.0f}" for v in design.values)
        upper.set_title(f"{design.label}\n{sizes} cm", fontsize=9)
        lower.set_title(f"{garment.num_vertices} vertices", fontsize=9)
        rows.append(
            {"design": design.label, **design.as_dict(), "vertices": garment.num_vertices} | asdict(garment.quality)
        )
    figure.suptitle(f"{len(designs)} {config.split} designs ({' · '.join(manifest.space.names)})")
    with atomic_path(config.out) as temporary:
        figure.savefig(temporary)
    record = {"config": asdict(config), "environment": environment(), "designs": rows}
    write_text(config.out.with_suffix(".json"), json.dumps(record, indent=2, default=str) + "\n")
    for row in rows:
        print(
            f"{row['design']:20} {row['vertices']:5} vertices, {row['total_area']:.3f} m², "
            f"mean {1e4 * row['mean_area']:.4f} cm², smallest angle {row['min_angle']:.1f}°, "
            f"distortion {row['mean_distortion']:.3f} mean {row['max_distortion']:.2f} worst"
        )
    print(f"wrote {config.out} and {config.out.with_suffix('.json')}")
