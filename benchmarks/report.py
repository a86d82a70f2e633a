"""Merge the records of `python -m benchmarks compare` into docs/BENCHMARKS.md: tables and plots, device by device."""

import json
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.compare import ALL
from benchmarks.record import RESULTS, table
from tryon_jax.atomic import atomic_path, write_text

ABOUT = {
    "Laplacian product": "L̃ x on the finest level, for the features of the first layer. Beside it: SciPy (one thread) "
    "and JAX's own `BCOO` product.",
    "Chebyshev layer": "One convolution from 64 to 64 features (`small`) or 168 to 168 (`paper`), without activation.",
    "U-Net forward": "Displacements of R_smooth for a batch of body shapes of one garment.",
    "U-Net gradient": "Loss and its gradient by all weights of R_smooth.",
    "drape": "Both U-Nets, from betas to vertices, as `tryon_jax.drape` is called.",
    "training step": "Gradient and AdamW of R_smooth.",
    "collision loss": "Shaped bodies, closest vertices, loss, and gradient by the garments' vertices.",
    "solver step": "One implicit step of the cloth solver with its linear solve, for a batch of states of one garment.",
    "full equilibrium": "From the mean body an eighth of a ray outwards, to rest: the dataset's unit of work.",
    "prepare": "From a design to a garment that can be draped: pattern, mesh, mean drape, graph. Host side.",
}
"""What each subject is."""
UNITS = {
    "Laplacian product": "shapes",
    "Chebyshev layer": "shapes",
    "solver step": "steps",
    "prepare": "garments",
}
"""What is counted per second; drapes for the others."""
BEGIN = "# Benchmarks"


@dataclass(frozen=True)
class Config:
    """Where from and where to."""

    results: Path = RESULTS
    """Folder of the records."""
    out: Path = Path("docs/BENCHMARKS.md")
    """The page; its plots go to images/ beside it."""
    plots: bool = True
    """Draw the plots (extra `pictures`)."""


def load_records(folder: Path) -> list[dict[str, Any]]:
    """All records of `compare`, CPUs first.

    Raises:
        FileNotFoundError: there is none.
    """
    records = []
    for path in sorted(folder.glob("*.json")):
        record = json.loads(path.read_text(encoding="utf-8"))
        if record.get("benchmark") == "compare":
            records.append(record)
    if not records:
        raise FileNotFoundError(f"no record of a comparison in {str(folder)!r}: run `python -m benchmarks compare`")
    return sorted(records, key=lambda r: (r["environment"]["platform"] != "cpu", r["environment"]["device"]))


def device(record: dict[str, Any]) -> str:
    """The device's name, as tables show it."""
    return record["environment"]["device"]


def machines(records: Sequence[dict[str, Any]]) -> str:
    """One line for each record: hardware, versions, ceilings, load."""
    rows = []
    for record in records:
        found, dense = record["environment"], record["ceilings"]["dense_gflops"]
        rows.append(
            {
                "device": device(record),
                "cores": found["cpu_cores"] if found["platform"] == "cpu" else "",
                "date": ", ".join(dict.fromkeys([found["date"], *(p["date"] for p in record.get("pieces", []))])),
                "jax": found["jax"],
                "dense products, GFLOP/s": ", ".join(f"{name} {value:.0f}" for name, value in dense.items()),
                "memory, GB/s": round(record["ceilings"]["bandwidth_gb_s"], 1),
                "load before and after": f"{found['load_average'][0]:g}, {record['load_average_after'][0]:g}",
                "minutes": record["minutes"],
            }
        )
    return table(rows)


def key(cell: dict[str, Any]) -> tuple[Any, ...]:
    """What identifies a cell on every device."""
    return tuple(cell[name] for name in ("subject", "config", "vertices", "batch", "precision"))


def subject_table(subject: str, records: Sequence[dict[str, Any]]) -> str:
    """Every timed cell of one subject on every device; "" where there is none."""
    cells = {}
    for number, record in enumerate(records):
        for cell in record["cells"]:
            if cell["subject"] == subject:
                cells.setdefault(key(cell), {})[number] = cell
    rows = []
    for (_, config, vertices, batch, precision), found in sorted(cells.items()):
        if not any("ms" in cell for cell in found.values()):
            continue
        row: dict[str, Any] = {"network": config, "vertices": vertices, "batch": batch, "precision": precision}
        for number, record in enumerate(records):
            row |= columns(found.get(number, {}), UNITS.get(subject, "drapes"), device(record), len(records) > 1)
        if len(records) > 1:
            row |= ratio([found.get(number, {}) for number in range(len(records))], records)
        rows.append(row)
    empty = [name for name in (rows[0] if rows else ()) if all(row[name] in ("", "–") for row in rows)]
    return table([{name: value for name, value in row.items() if name not in empty} for row in rows]) if rows else ""


def columns(cell: dict[str, Any], counted: str, name: str, named: bool) -> dict[str, Any]:
    """A device's part of a row."""
    prefix = f"{name}: " if named else ""
    if "ms" not in cell:
        blank = ("ms (quartiles)", f"{counted}/s", "of ceiling", "compile, s (number)", "MB", "error", "mJ", "beside")
        return {prefix + title: "–" for title in blank}
    share, memory, energy = cell.get("share_of_ceiling"), cell.get("memory_mb"), cell.get("joules")
    beside = ", ".join(
        f"{peer} {statistics.median(times) / cell['ms']:.2f}×" for peer, times in cell.get("beside", {}).items()
    )
    return {
        prefix + "ms (quartiles)": f"{cell['ms']:.3g} ({cell['lower_ms']:.3g} to {cell['upper_ms']:.3g})",
        prefix + f"{counted}/s": f"{cell['per_second']:.3g}",
        prefix + "of ceiling": "–" if share is None else f"{100 * share:.0f} %",
        prefix + "compile, s (number)": f"{cell['compile_s']:.1f} ({cell['compilations']})",
        prefix + "MB": "–" if memory is None else f"{memory:.0f}",
        prefix + "error": f"{cell['error']:.1g} {cell['unit']}".strip(),
        prefix + "mJ": "–" if energy is None else f"{1e3 * energy:.3g}",
        prefix + "beside": beside or "–",
    }


def ratio(cells: Sequence[dict[str, Any]], records: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Throughput of the first GPU over the first CPU."""
    platforms = [record["environment"]["platform"] for record in records]
    if not {"cpu", "gpu"} <= set(platforms):
        return {}
    cpu, gpu = cells[platforms.index("cpu")], cells[platforms.index("gpu")]
    both = "ms" in cpu and "ms" in gpu
    return {"GPU ÷ CPU": f"{gpu['per_second'] / cpu['per_second']:.1f}" if both else "–"}


def skipped_list(records: Sequence[dict[str, Any]]) -> list[str]:
    """What was not measured, with the reason, grouped."""
    lines = []
    for record in records:
        groups: dict[tuple[str, str, str, str], list[str]] = {}
        for cell in record["cells"]:
            if "skipped" in cell:
                group = (cell["subject"], cell["config"], cell["precision"], cell["skipped"])
                groups.setdefault(group, []).append(f"{cell['vertices']:,} × {cell['batch']}")
        for (subject, config, precision, reason), sizes in groups.items():
            name = " ".join(part for part in (subject, config, precision if precision != "float32" else "") if part)
            lines.append(f"- {device(record)}: {name}, vertices × batch {', '.join(sizes)}: {reason}.")
    return lines


def page(records: Sequence[dict[str, Any]], pictures: Sequence[str]) -> str:
    """The whole page."""
    parts = [
        BEGIN,
        "Made by `python -m benchmarks report` from the records that `python -m benchmarks compare` wrote, one on each "
        "machine; nothing here is typed in by hand. Every cell is checked against float64 before it is timed. Medians "
        "and quartiles of calls that take turns with what stands beside them, each with fresh inputs. Of ceiling: the "
        "time that the operations, or the bytes of every operand read or written once, take at the speed of the large "
        "dense product or of the memory measured in the same run, whichever is longer, over the time taken. MB: "
        "arguments, results and everything between as XLA planned it. Beside: time of the peer over ours, so more than "
        "1 is slower than ours; dense products are the same matrix products with no sparse operator and no activation. "
        "A load above the number of cores says that other work disturbed the run.",
        "## Machines",
        machines(records),
    ]
    parts += [f"![{Path(name).stem.replace('-', ' ')}](images/{name})" for name in pictures]
    for subject in ALL:
        made = subject_table(subject, records)
        if made:
            parts += [f"## {subject[0].upper()}{subject[1:]}", ABOUT[subject], made]
    lines = skipped_list(records)
    if lines:
        parts += ["## Not measured", "\n".join(lines)]
    if not any(record["environment"]["platform"] == "gpu" for record in records):
        parts += ["No GPU has been measured yet; benchmarks/PENDING_GPU.md has the commands."]
    return "\n\n".join(parts) + "\n"


def draw(records: Sequence[dict[str, Any]], folder: Path) -> list[str]:
    """Throughput over the batch and time over the vertices; names of the pictures."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    names = []
    for across, fixed, title, value, label in (
        ("batch", "vertices", "benchmarks-batch.png", "per_second", "per second"),
        ("vertices", "batch", "benchmarks-vertices.png", "ms", "milliseconds"),
    ):
        figure, axes = plt.subplots(1, 2, figsize=(12, 5), constrained_layout=True)
        drawn = False
        for axis, network in zip(axes, ("small", "paper"), strict=True):
            at = None
            for record in records:
                at = record["config"]["at_vertices" if fixed == "vertices" else "at_batch"]
                for subject in ALL:
                    points = sorted(
                        (c[across], c[value])
                        for c in record["cells"]
                        if c["subject"] == subject
                        and c["config"] in (network, "")
                        and c["precision"] == "float32"
                        and c[fixed] == at
                        and "ms" in c
                    )
                    if len(points) > 1:
                        style = "-o" if record["environment"]["platform"] == "cpu" else "--s"
                        named = subject if len(records) == 1 else f"{subject}, {device(record)}"
                        axis.loglog(*zip(*points, strict=True), style, label=named)
                        drawn = True
            axis.set(xlabel=across, ylabel=label, title=f"{network}, {at:,} {fixed}" if at else network)
            axis.grid(alpha=0.3, which="both")
            if axis.lines:
                axis.legend(fontsize=7)
        if drawn:
            folder.mkdir(parents=True, exist_ok=True)
            with atomic_path(folder / title) as temporary:
                figure.savefig(temporary, dpi=110)
            names.append(title)
        plt.close(figure)
    return names


def main(config: Config) -> None:
    """Write the page and its plots."""
    records = load_records(config.results)
    pictures = draw(records, config.out.parent / "images") if config.plots else []
    write_text(config.out, page(records, pictures))
    print(f"wrote {config.out} from {len(records)} records")
