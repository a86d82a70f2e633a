"""Merge the records of `python -m benchmarks compare` into docs/BENCHMARKS.md, or compare two records of any benchmark.

python -m benchmarks report
python -m benchmarks report --compare before.json after.json
"""

import json
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks._before_after import compared, read_record
from benchmarks._host_steps import host_sections, load_host_records
from benchmarks._platforms import aims_table, key, platform_table, share_of_ceiling
from benchmarks.campaign import OUTCOMES
from benchmarks.compare import ALL
from benchmarks.record import RESULTS
from measuring.records import table
from tryon_jax.files.atomic import atomic_path, write_text

ABOUT = {
    "Laplacian product": "L̃ x on the finest level, for the features of the first layer. Beside it: SciPy (one thread) "
    "and JAX's own `BCOO` product.",
    "Chebyshev layer": "One convolution from 64 to 64 features (`small`) or 168 to 168 (`paper`), without activation.",
    "U-Net forward": "Displacements of R_smooth for a batch of body shapes of one garment.",
    "U-Net gradient": "Loss and its gradient by all weights of R_smooth.",
    "drape with fields": "Both U-Nets once for the garment, then the sum of their fields for every body, as "
    "`tryon_jax.drape` is called.",
    "drape": "The paper's form, betas at each node: both U-Nets for every body, as `tryon_jax.drape` is called.",
    "training step": "Gradient and AdamW of R_smooth.",
    "collision loss": "Shaped bodies, closest vertices, loss, and gradient by the garments' vertices.",
    "solver step": "One implicit step of the cloth solver with its linear solve, for a batch of states of one garment.",
    "side by side": "The same as a full equilibrium, so many bodies in lanes of one mapped solve.",
    "full equilibrium": "From the mean body an eighth of a ray outwards, to rest: the dataset's unit of work.",
    "push-out": "A drape out of a body, by the smallest displacement. Host side.",
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
STYLES: tuple[Any, ...] = ("-o", ":s", "--^", "-.v")
"""Line and marker of each device in the plots."""
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
    compare: tuple[Path, Path] | None = None
    """Two records of one benchmark, before a change and after it: print every time of both and their ratio instead."""


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


def device(record: Mapping[str, Any]) -> str:
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


def subject_table(subject: str, records: Sequence[dict[str, Any]]) -> str:
    """Every timed cell of one subject, a line for each device; "" where there is none."""
    lines = []
    for number, record in enumerate(records):
        lines += [(key(cell), number, cell) for cell in record["cells"] if cell["subject"] == subject and "ms" in cell]
    first = {identity: cell for identity, number, cell in lines if number == 0}
    rows = []
    for identity, number, cell in sorted(lines, key=lambda line: line[:2]):
        _, config, vertices, batch, precision = identity
        row: dict[str, Any] = {"network": config, "vertices": vertices, "batch": batch, "precision": precision}
        ceiling = ceiling_share(cell, records[number]["ceilings"])
        row |= {"device": device(records[number])} | columns(cell, UNITS.get(subject, "drapes"), ceiling)
        against = first.get(identity) if number else None
        row["× the first device"] = "–" if against is None else f"{cell['per_second'] / against['per_second']:.3g}"
        rows.append(row)
    empty = [name for name in (rows[0] if rows else ()) if all(row[name] in ("", "–") for row in rows)]
    return table([{name: value for name, value in row.items() if name not in empty} for row in rows]) if rows else ""


def ceiling_share(cell: Mapping[str, Any], ceilings: Mapping[str, Any]) -> str:
    """Time at the ceiling over the time taken, in words where the record has no ceiling for this cell."""
    if "share_of_ceiling" not in cell:
        return "–"
    share = share_of_ceiling(cell, ceilings)
    return "may fit in cache, no memory ceiling" if share is None else f"{100 * share:.0f} %"


def columns(cell: dict[str, Any], counted: str, ceiling: str) -> dict[str, str]:
    """What was measured, as a line shows it; `ceiling` is what stands in the column "of ceiling"."""
    memory, energy = cell.get("memory_mb"), cell.get("joules")
    beside = ", ".join(
        f"{peer} {statistics.median(times) / cell['ms']:.2f}×" for peer, times in cell.get("beside", {}).items()
    )
    return {
        "ms (quartiles)": f"{cell['ms']:.3g} ({cell['lower_ms']:.3g} to {cell['upper_ms']:.3g})",
        f"{counted}/s": f"{cell['per_second']:.3g}",
        "of ceiling": ceiling,
        "compile, s (number)": f"{cell['compile_s']:.1f} ({cell['compilations']})",
        "MB": "–" if memory is None else f"{memory:.0f}",
        "error": f"{cell['error']:.1g} {cell['unit']}".strip(),
        "mJ": "–" if energy is None else f"{1e3 * energy:.3g}",
        "beside": beside or "–",
    }


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


def load_campaigns(folder: Path) -> list[dict[str, Any]]:
    """All records of `campaign`, those of the fewest cases first."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("campaign-*.json"))]
    return sorted(found, key=lambda record: record["rows"][0]["cases"])


def campaign_section(campaigns: Sequence[dict[str, Any]]) -> list[str]:
    """What came of random cases, and every fault; nothing where none were run."""
    if not campaigns:
        return []
    lines, faults = [], []
    for record in campaigns:
        row = record["rows"][0]
        line = {"device": device(record), "date": record["environment"]["date"], "seed": record["config"]["seed"]}
        line |= {name: row["outcomes"].get(name, 0) for name in OUTCOMES}
        line |= {"faults": len(row["faults"]), "longest edge ÷ rest": row["longest_edge"]}
        line |= {"largest push, mm": 1e3 * row["largest_push"], "s a case": row["seconds"] / row["cases"]}
        lines.append({"cases": row["cases"]} | line)
        faults += [f"- {fault['fault']}: {fault['design']}, betas {fault['betas']}" for fault in row["faults"]]
    about = (
        "Random designs, meshes, bodies and fabrics through the whole try-on (`python -m benchmarks campaign`): what "
        "the gate says of each, and faults, which are what raises, is torn without being refused, or is inside the "
        "body after the push out by winding numbers. Edges and pushes are those of drapes that were not refused; times "
        "are with whatever else the machine did."
    )
    return ["## Random cases", about, table(lines), *(["\n".join(faults)] if faults else [])]


def page(
    records: Sequence[dict[str, Any]],
    pictures: Sequence[str],
    campaigns: Sequence[dict[str, Any]] = (),
    host: Sequence[dict[str, Any]] = (),
) -> str:
    """The whole page.

    Args:
        records: Of `compare`.
        pictures: Names of the plots.
        campaigns: Records of `campaign`.
        host: Records of `wear` and `picture`.
    """
    parts = [
        BEGIN,
        "Made by `python -m benchmarks report` from the records that `python -m benchmarks compare` wrote on each "
        "machine, and `python -m benchmarks gpu` in short runs on GPUs; nothing here is typed in by hand. Every cell "
        "is checked against float64 before it is timed. Medians "
        "and quartiles of calls that take turns with what stands beside them, each with fresh inputs. Of ceiling: the "
        "time that the operations, or the bytes of every operand read or written once, take at the speed of the large "
        "dense product or of the memory measured in the same run, whichever is longer, over the time taken; the memory "
        "is measured on arrays as large as the cell's, or, in older runs, on large arrays alone, which say nothing of "
        "what fits in a cache. MB: "
        "arguments, results and everything between as XLA planned it. Beside: time of the peer over ours, so more than "
        "1 is slower than ours; dense products are the same matrix products with no sparse operator and no activation. "
        f"The last column compares throughput with that of {device(records[0])}. A load above "
        "the number of cores says that other work disturbed the run.",
        "## Machines",
        machines(records),
        "## Aims",
        "Best cell of each, in float32. The simulated drapes are those of bodies an eighth of a ray apart.",
        aims_table(records),
        "## CPU and GPU side by side",
        "XLA on the fastest CPU and on the fastest GPU that have measured a line: calls count as in the tables below.",
        platform_table(records),
    ]
    parts += [f"![{Path(name).stem.replace('-', ' ')}](images/{name})" for name in pictures]
    for subject in ALL:
        made = subject_table(subject, records)
        if made:
            parts += [f"## {subject[0].upper()}{subject[1:]}", ABOUT[subject], made]
    parts += [*host_sections(host), *campaign_section(campaigns)]
    lines = skipped_list(records)
    if lines:
        parts += ["## Not measured", "\n".join(lines)]
    if not any(record["environment"]["platform"] == "gpu" for record in records):
        parts += ["No GPU has been measured yet; benchmarks/PENDING_GPU.md has the command."]
    return "\n\n".join(parts) + "\n"


def draw(records: Sequence[dict[str, Any]], folder: Path) -> list[str]:
    """Throughput over the batch and time over the vertices: a colour for each subject, a line style for each device;
    names of the pictures."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.lines import Line2D

    names = []
    for across, fixed, title, value, label in (
        ("batch", "vertices", "benchmarks-batch.png", "per_second", "per second"),
        ("vertices", "batch", "benchmarks-vertices.png", "ms", "milliseconds"),
    ):
        figure, axes = plt.subplots(1, 2, figsize=(12, 6), sharey=True, constrained_layout=True)
        shown = set()
        for axis, network in zip(axes, ("small", "paper"), strict=True):
            for number, record in enumerate(records):
                for subject in ALL:
                    points = curve(record, subject, network, across, fixed, value)
                    if len(points) > 1:
                        axis.loglog(*zip(*points, strict=True), STYLES[number % len(STYLES)], color=colour(subject))
                        shown.add(subject)
            at = records[0]["config"]["at_vertices" if fixed == "vertices" else "at_batch"]
            axis.set(xlabel=across, ylabel=label, title=f"{network}, {fixed}: {at:,}")
            axis.grid(alpha=0.3, which="both")
        if shown:
            handles = [Line2D([], [], color=colour(name), lw=3, label=name) for name in ALL if name in shown]
            handles += [
                Line2D([], [], color="0.2", label=device(record), linestyle=style[:-1], marker=style[-1])
                for record, style in zip(records, STYLES * len(records), strict=False)
            ]
            figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=9)
            folder.mkdir(parents=True, exist_ok=True)
            with atomic_path(folder / title) as temporary:
                figure.savefig(temporary, dpi=110)
            names.append(title)
        plt.close(figure)
    return names


def curve(
    record: dict[str, Any], subject: str, network: str, across: str, fixed: str, value: str
) -> list[tuple[float, float]]:
    """A subject's points in float32 on one device, all else in the middle of its sweep."""
    at = record["config"]["at_vertices" if fixed == "vertices" else "at_batch"]
    wanted = {"subject": subject, "precision": "float32", fixed: at}
    return sorted(
        (cell[across], cell[value])
        for cell in record["cells"]
        if "ms" in cell and cell["config"] in (network, "") and all(cell[k] == v for k, v in wanted.items())
    )


def colour(subject: str) -> str:
    """Of a subject in every plot."""
    return f"C{ALL.index(subject)}"


def main(config: Config) -> None:
    """Write the page and its plots, or print how two records differ."""
    if config.compare is not None:
        print(compared(*(read_record(path) for path in config.compare)))
        return
    records = load_records(config.results)
    pictures = draw(records, config.out.parent / "images") if config.plots else []
    write_text(config.out, page(records, pictures, load_campaigns(config.results), load_host_records(config.results)))
    print(f"wrote {config.out} from {len(records)} records")
