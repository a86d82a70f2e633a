"""What CPUs and GPUs do side by side, line by line, and how far a GPU is from the aims."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from benchmarks._plan import simulator_cells, throughput_cells
from benchmarks.compare import ALL
from measuring.records import table

NOT_MEASURED = "not measured"
DATASET = 15_276
"""Drapes of the data set at the paper's scale: 19 designs, 2 topologies, 2 fabrics, 201 body shapes."""
PLATFORMS = ("cpu", "gpu")
BOUND_BY_MEMORY = ("Laplacian product", "solver step")
"""Subjects whose ceiling is the memory's."""
CACHE_MB = 128.0
"""Working sets below this, 10⁶ bytes, may lie in a cache of any machine that was measured."""
Key = tuple[Any, ...]


def key(cell: Mapping[str, Any]) -> Key:
    """What identifies a cell on every device."""
    return tuple(cell[name] for name in ("subject", "config", "vertices", "batch", "precision"))


def share_of_ceiling(cell: Mapping[str, Any], ceilings: Mapping[str, Any]) -> float | None:
    """Time at the ceiling over the time taken; None where the record has no ceiling for a working set of this size.

    Records whose memory was measured on large arrays alone have none for working sets that may lie in a cache.
    """
    measured_in_cache = "bandwidth_gb_s_by_mb" in ceilings
    small = (cell.get("memory_mb") or 0.0) < CACHE_MB
    if cell["subject"] in BOUND_BY_MEMORY and small and not measured_in_cache:
        return None
    return cell.get("share_of_ceiling")


def fastest(records: Sequence[Mapping[str, Any]], platform: str) -> dict[Key, tuple[Mapping[str, Any], str]]:
    """Each timed cell of the fastest device of a platform, and the device; `share_of_ceiling` where it holds."""
    found: dict[Key, tuple[Mapping[str, Any], str]] = {}
    for record in records:
        if record["environment"]["platform"] != platform:
            continue
        for cell in record["cells"]:
            if "ms" in cell and (key(cell) not in found or cell["ms"] < found[key(cell)][0]["ms"]):
                share = share_of_ceiling(cell, record["ceilings"])
                found[key(cell)] = {**cell, "share_of_ceiling": share}, record["environment"]["device"]
    return found


def planned() -> list[Key]:
    """The cells of a run on a GPU, at its defaults."""
    cells = throughput_cells(("small", "paper"), (1414, 3581, 14_000, 100_000), (1, 64, 4096), 3581, 64)
    cells += simulator_cells(3581, (1, 16, 64, 256))
    return [(c.subject, c.config, c.vertices, c.batch, c.precision) for c in cells]


def platform_table(records: Sequence[Mapping[str, Any]]) -> str:
    """A line for each cell that a GPU has timed, or that a run on one would and a CPU has: fastest CPU, fastest GPU."""
    cpu, gpu = (fastest(records, platform) for platform in PLATFORMS)
    order = {subject: k for k, subject in enumerate(ALL)}
    known = [k for k in {*gpu, *(k for k in planned() if k in cpu)} if k[0] in order]
    rows = []
    for identity in sorted(known, key=lambda k: (order[k[0]], *k[1:])):
        subject, config, vertices, batch, precision = identity
        row: dict[str, Any] = {"subject": subject, "network": config, "vertices": vertices, "batch": batch}
        row["precision"] = precision
        cells = [found[identity][0] if identity in found else None for found in (cpu, gpu)]
        for name, cell in zip(("CPU", "GPU"), cells, strict=True):
            row |= _columns(name, cell)
        rate = [cell["per_second"] if cell else None for cell in cells]
        row["GPU × CPU"] = f"{rate[1] / rate[0]:.3g}" if rate[0] and rate[1] else "–"
        rows.append(row)
    return table(rows)


def _columns(name: str, cell: Mapping[str, Any] | None) -> dict[str, str]:
    if cell is None:
        return {f"{name}, per s": NOT_MEASURED, f"{name}, of ceiling": "–", f"{name}, mJ": "–"}
    share, energy = cell.get("share_of_ceiling"), cell.get("joules")
    return {
        f"{name}, per s": f"{cell['per_second']:.3g}",
        f"{name}, of ceiling": "–" if share is None else f"{100 * share:.0f} %",
        f"{name}, mJ": "–" if energy is None else f"{1e3 * energy:.3g}",
    }


def aims_table(records: Sequence[Mapping[str, Any]]) -> str:
    """Each aim beside what was reached, with the device and the cell that reached it."""
    rows = []
    for aim, subjects, config, value, show in AIMS:
        row = {"aim, on an H100": aim}
        for platform in PLATFORMS:
            cells = [
                (value(cell), cell, device)
                for identity, (cell, device) in fastest(records, platform).items()
                if identity[0] in subjects and identity[1] == config and identity[4] == "float32"
                if value(cell) is not None
            ]
            best = max(cells, key=lambda found: found[0], default=None)
            row[platform.upper()] = NOT_MEASURED if best is None else _told(show(best[0]), best[1], best[2])
        rows.append(row)
    return table(rows)


def _told(value: str, cell: Mapping[str, Any], device: str) -> str:
    return f"{value} ({cell['subject']}, {cell['vertices']:,} vertices × {cell['batch']:,}, {device})"


def _rate_at_working_density(cell: Mapping[str, Any]) -> float | None:
    return cell["per_second"] if cell["vertices"] == 3581 else None


AIMS: tuple[tuple[str, tuple[str, ...], str, Callable[[Mapping[str, Any]], Any], Callable[[float], str]], ...] = (
    (
        "half of the ceiling for layers of `paper`",
        ("Chebyshev layer", "Laplacian product"),
        "paper",
        lambda cell: cell.get("share_of_ceiling"),
        lambda share: f"{100 * share:.0f} %",
    ),
    (
        "100,000 drapes a second with fields",
        ("drape with fields",),
        "small",
        _rate_at_working_density,
        lambda rate: f"{rate:,.0f}",
    ),
    (
        f"{DATASET:,} drapes simulated in 10 minutes",
        ("side by side",),
        "",
        _rate_at_working_density,
        lambda rate: f"{DATASET / rate / 60:.3g} minutes at the rate",
    ),
)
"""Aim, subjects, network, what is compared (more is better), how it is told."""
