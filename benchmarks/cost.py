"""What simulating, training and draping cost, from the records of `compare` and of the weights, in docs/cost.md.

python -m benchmarks cost
python -m benchmarks cost --cpu-price 0.05 --gpu-price 3
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.record import RESULTS, table
from benchmarks.report import device, load_records
from tryon_jax.checks import check_range
from tryon_jax.files.atomic import write_text
from tryon_jax.nets.store import read_record
from tryon_jax.training.recipes import chain

SHAPES = 201
"""Body shapes of the dataset, the mean body included."""
CATALOGUES = ((19, 201), (100, 100), (1_000, 100), (1_000, 1_000), (10_000, 1_000), (100_000, 1_000))
"""Garments × bodies."""
DATASETS = ((38, 2, 201), (76, 2, 201), (200, 2, 201), (1_000, 2, 201))
"""Garments (designs × topologies), fabrics, shapes."""
BYTES = 12
"""Of a vertex in float32."""


@dataclass(frozen=True)
class Config:
    """Where from, where to, and the prices, which are assumptions and not measurements."""

    results: Path = RESULTS
    """Folder of the records of `python -m benchmarks compare`."""
    out: Path = Path("docs/cost.md")
    cpu_price: float = 0.04
    """Euros for a core and an hour."""
    gpu_price: float = 2.5
    """Euros for a GPU and an hour."""


@dataclass(frozen=True)
class Rates:
    """What one device was measured to do."""

    name: str
    platform: str
    price: float
    """Euros an hour for the device."""
    drapes: float
    """Drapes a second, at the batch that does most."""
    drape_vertices: int
    prepare: float | None
    """Seconds from a design to a garment."""
    equilibrium: tuple[float, float] | None
    """(c, p): seconds for a simulated shape are c (vertices / 3581)^p, one process on the whole device."""


def rates(record: Mapping[str, Any], cpu_price: float, gpu_price: float) -> Rates | None:
    """Rates of a record, or None where it has no drape in float32."""
    timed = [cell for cell in record["cells"] if "ms" in cell and cell["precision"] == "float32"]
    drapes = [c for c in timed if (c["subject"], c["config"]) == ("drape", "small")]
    at = [c for c in drapes if c["vertices"] == record["config"]["at_vertices"]] or drapes
    if not at:
        return None
    best = max(at, key=lambda c: c["per_second"])
    cpu = record["environment"]["platform"] == "cpu"
    prepared = [c["ms"] for c in timed if c["subject"] == "prepare"]
    return Rates(
        device(record),
        record["environment"]["platform"],
        cpu_price * record["environment"]["cpu_cores"] if cpu else gpu_price,
        best["per_second"],
        best["vertices"],
        1e-3 * max(prepared) if prepared else None,
        growth([(c["vertices"], 1e-3 * c["ms"]) for c in timed if c["subject"] == "full equilibrium"]),
    )


def growth(points: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """(c, p) of seconds = c (vertices / 3581)^p through measured points; linear where there is only one."""
    if not points:
        return None
    size, seconds = np.log(np.array(points, float)).T
    size = size - np.log(3581)
    power = 1.0 if len(points) == 1 else float(np.polyfit(size, seconds, 1)[0])
    return float(np.exp(np.mean(seconds - power * size))), power


def hours(seconds: float) -> str:
    """A duration that a person can read."""
    if seconds < 60:
        return f"{seconds:.2g} s"
    if seconds < 3600:
        return f"{seconds / 60:.3g} min"
    if seconds < 100 * 3600:
        return f"{seconds / 3600:.3g} h"
    return f"{seconds / 86400:.3g} days"


def size(number: float) -> str:
    """Bytes in powers of a thousand."""
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if number < 1000:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.3g} PB"


def catalogue_rows(rate: Rates) -> list[dict[str, Any]]:
    """Draping catalogues of several sizes on one device."""
    rows = []
    for garments, bodies in CATALOGUES:
        prepare = garments * (rate.prepare or 0.0)
        draping = garments * bodies / rate.drapes
        total = prepare + draping
        rows.append(
            {
                "garments × bodies": f"{garments:,} × {bodies:,}",
                "prepare": hours(prepare) if rate.prepare else "not measured",
                "drape": hours(draping),
                "both": hours(total),
                "euros": f"{total / 3600 * rate.price:.3g}",
                "drapes per euro": f"{garments * bodies / max(total / 3600 * rate.price, 1e-12):,.0f}",
                "vertices in float32": size(garments * bodies * rate.drape_vertices * BYTES),
            }
        )
    return rows


def dataset_rows(rate: Rates) -> list[dict[str, Any]]:
    """Simulating datasets of several sizes on one device."""
    assert rate.equilibrium is not None
    seconds, power = rate.equilibrium
    rows = []
    for garments, fabrics, shapes in DATASETS:
        for vertices in (1414, 3581, 14_000):
            total = garments * fabrics * shapes * seconds * (vertices / 3581) ** power
            rows.append(
                {
                    "garments × fabrics × shapes": f"{garments:,} × {fabrics} × {shapes}",
                    "vertices": vertices,
                    "simulate": hours(total),
                    "euros": f"{total / 3600 * rate.price:.3g}",
                    "drapes per euro": f"{garments * fabrics * shapes / (total / 3600 * rate.price):,.0f}",
                }
            )
    return rows


def training_rows(training: Mapping[str, Any], cpu_price: float) -> list[dict[str, Any]]:
    """What the shipped weights took, as their record says."""
    rows = []
    for stage, found in _trainings(training):
        if "seconds" in found:
            steps = found.get("steps", 0)
            rows.append(
                {
                    "stage": stage,
                    "samples": found.get("samples", ""),
                    "steps": steps,
                    "time": hours(found["seconds"]),
                    "ms a step": f"{1e3 * found['seconds'] / max(steps, 1):.0f}",
                    "euros on two cores": f"{found['seconds'] / 3600 * 2 * cpu_price:.2g}",
                }
            )
    return rows


def _trainings(training: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Each stage with its record, those that it continues first."""
    for stage, found in training.items():
        if not isinstance(found, Mapping):
            continue
        for k, part in enumerate(chain(found)):
            yield (f"{stage}, continued" if k else stage), part


def page(found: Sequence[Rates], training: Mapping[str, Any], config: Config) -> str:
    """The page."""
    parts = [
        "# Cost",
        "Made by `python -m benchmarks cost` from measured numbers: the records of `python -m benchmarks compare` and "
        f"the training record in the shipped weights. Prices are assumptions: {config.cpu_price:g} € for a core and an "
        f"hour, {config.gpu_price:g} € for a GPU and an hour. Devices that have not been measured are not here.",
        "Everything is a list of independent pieces: a garment with a block of bodies, a garment with a fabric and a "
        "ray of bodies. N devices take an N-th of the time for the same money, as long as there are more pieces than "
        "devices. Time grows linearly with garments and with bodies; with vertices as measured.",
    ]
    for rate in found:
        cores = "" if rate.platform == "gpu" else f", {rate.price:.2f} € an hour with all its cores"
        parts += [
            f"## {rate.name}",
            f"{rate.drapes:.3g} drapes a second at {rate.drape_vertices:,} vertices (`small`){cores}: "
            f"{3600 * rate.drapes:,.0f} an hour, {3600 * rate.drapes / rate.price:,.0f} for a euro.",
            "### Draping a catalogue",
            table(catalogue_rows(rate)),
        ]
        if rate.equilibrium:
            parts += [
                "### Simulating a dataset",
                f"A shape takes {rate.equilibrium[0]:.2f} s at 3,581 vertices and grows with their number to the power "
                f"{rate.equilibrium[1]:.2f} (fit through the measured sizes; one process).",
                table(dataset_rows(rate)),
            ]
    rows = training_rows(training, config.cpu_price)
    if rows:
        parts += ["## Training", "What the shipped weights took, on the machine that trained them.", table(rows)]
    parts += [
        "## On many machines",
        "Workers need the library and the same folders. One core each is best for the solver and for `small`:",
        "```bash\n"
        "dask scheduler --port 8786                                   # one machine; extra `distributed`\n"
        'XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1" \\\n'
        "    dask worker tcp://HOST:8786 --nworkers 16 --nthreads 1 --memory-limit 0      # every machine\n"
        "python -m experiments simulate --out DATA --scheduler tcp://HOST:8786\n"
        "python -m experiments drape_catalogue --out DRAPES --garments 100000 --bodies 1000 "
        "--scheduler tcp://HOST:8786\n"
        "```",
        "Each piece is a file that is written in one step. What a lost worker was doing is given to another; what is "
        "done stays done; `checksums.txt` is the same however many worked.",
        "Training uses all devices of a machine by itself, and those of several with `python -m experiments "
        "train_parallel --coordinator HOST:12345 --processes 4 --process 0` (1, 2, 3 on the others). The curve is "
        "that of one device to 1e-5. When a process is lost all end; the same commands continue from the last "
        "checkpoint.",
    ]
    return "\n\n".join(parts) + "\n"


def main(config: Config) -> None:
    """Write the page."""
    check_range("cpu_price", config.cpu_price, 1e-6, 1e6)
    check_range("gpu_price", config.gpu_price, 1e-6, 1e6)
    found = [rates(record, config.cpu_price, config.gpu_price) for record in load_records(config.results)]
    known = [rate for rate in found if rate is not None]
    if not known:
        raise ValueError(f"no record in {str(config.results)!r} has timed the drape of `small`")
    with resources.as_file(resources.files("tryon_jax") / "data" / "models" / "small.safetensors") as path:
        training = read_record(path).get("training", {})
    write_text(config.out, page(known, training, config))
    print(f"wrote {config.out} from {len(known)} records")
