"""What simulating, training and draping cost, from records of benchmarks and of the weights, in docs/cost.md.

python -m benchmarks cost
python -m benchmarks cost --cpu-price 0.05 --gpu-price 3
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.catalogue import VARIANTS
from benchmarks.record import RESULTS
from benchmarks.report import device, load_records
from measuring.records import table
from tryon_jax.checks import check_range
from tryon_jax.commands._catalogue import Options
from tryon_jax.files.atomic import write_text
from tryon_jax.nets.store import read_record
from tryon_jax.training.run_folder import chain

SHAPES = 201
"""Body shapes of the dataset, the mean body included."""
CATALOGUES = ((19, 201), (100, 100), (1_000, 100), (1_000, 1_000), (10_000, 1_000), (100_000, 1_000))
"""Garments × bodies."""
DATASETS = ((38, 2, 201), (76, 2, 201), (200, 2, 201), (1_000, 2, 201))
"""Garments (designs × topologies), fabrics, shapes."""
BLOCK = Options.block
"""Bodies for which a garment is prepared once: a block of a catalogue."""


@dataclass(frozen=True)
class Config:
    """Where from, where to, and the prices, which are assumptions and not measurements."""

    results: Path = RESULTS
    """Folder of the records of `python -m benchmarks compare` and `catalogue`."""
    out: Path = Path("docs/cost.md")
    cpu_price: float = 0.04
    """Euros for a core and an hour."""
    gpu_price: float = 2.5
    """Euros for a GPU and an hour."""


@dataclass(frozen=True)
class CatalogueRates:
    """What one core was measured to do for `tryon catalogue`, means over garments."""

    prepare: float
    """Seconds from a design to a garment."""
    drape: float
    """Seconds for a drape that is pushed out, measured and judged."""
    alone: float
    """Seconds for a drape that is only written."""
    file: float
    """Bytes of a drape."""


@dataclass(frozen=True)
class Rates:
    """What one device was measured to do."""

    name: str
    platform: str
    cores: int
    price: float
    """Euros an hour for the device."""
    catalogue: CatalogueRates | None
    equilibrium: tuple[float, float] | None
    """(c, p): seconds for a simulated shape are c (vertices / 3581)^p, one process on the whole device."""


def rates(
    record: Mapping[str, Any], catalogues: Mapping[str, CatalogueRates], cpu_price: float, gpu_price: float
) -> Rates | None:
    """Rates of a record of `compare`, or None where neither catalogue nor simulation was measured on its device.

    Args:
        record: Of `compare`.
        catalogues: By device, from `load_catalogues`.
        cpu_price: Euros for a core and an hour.
        gpu_price: Euros for a GPU and an hour.
    """
    timed = [cell for cell in record["cells"] if "ms" in cell and cell["precision"] == "float32"]
    cpu = record["environment"]["platform"] == "cpu"
    found = Rates(
        device(record),
        record["environment"]["platform"],
        record["environment"]["cpu_cores"] if cpu else 1,
        cpu_price * record["environment"]["cpu_cores"] if cpu else gpu_price,
        catalogues.get(device(record)),
        growth([(c["vertices"], 1e-3 * c["ms"]) for c in timed if c["subject"] == "full equilibrium"]),
    )
    return None if found.catalogue is None and found.equilibrium is None else found


def load_catalogues(folder: Path) -> dict[str, CatalogueRates]:
    """What records of `catalogue` say, by device."""
    found = {}
    for path in sorted(folder.glob("catalogue-*.json")):
        record = json.loads(path.read_text(encoding="utf-8"))

        def mean(name: str, record: Mapping[str, Any] = record) -> float:
            return float(np.mean([row[name] for row in record["rows"]]))

        drape, alone = (1e-3 * mean(f"{variant}, ms a drape") for variant in VARIANTS)
        found[device(record)] = CatalogueRates(1e-3 * mean("prepare, ms"), drape, alone, mean("file, bytes a drape"))
    return found


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
    assert rate.catalogue is not None
    core, rows = rate.catalogue, []
    for garments, bodies in CATALOGUES:
        drapes = garments * bodies
        prepare = garments * -(-bodies // BLOCK) * core.prepare / rate.cores
        guaranteed, alone = (prepare + drapes * each / rate.cores for each in (core.drape, core.alone))
        euros = guaranteed / 3600 * rate.price
        rows.append(
            {
                "garments × bodies": f"{garments:,} × {bodies:,}",
                "prepare": hours(prepare),
                "in all": hours(guaranteed),
                "euros": f"{euros:.3g}",
                "drapes per euro": f"{drapes / max(euros, 1e-12):,.0f}",
                "in all, draped alone": hours(alone),
                "files": size(drapes * core.file),
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
                    "ms a step": f"{1e3 * found['seconds'] / steps:.0f}" if steps else "",
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
        "`catalogue`, and the training record in the shipped weights. Prices are assumptions: "
        f"{config.cpu_price:g} € for a core and an hour, {config.gpu_price:g} € for a GPU and an hour. Devices that "
        "have not been measured are not here.",
        "Everything is a list of independent pieces: a garment with a block of bodies, a garment with a fabric and a "
        "ray of bodies. N devices take an N-th of the time for the same money, as long as there are more pieces than "
        "devices. Time grows linearly with garments and with bodies; with vertices as measured.",
    ]
    for rate in found:
        cores = "" if rate.platform == "gpu" else f" with all its {rate.cores} cores"
        parts += [f"## {rate.name}", f"{rate.price:.2f} € an hour{cores}.", "### Draping a catalogue"]
        if rate.catalogue is None:
            parts += ["Not measured here (`python -m benchmarks catalogue`)."]
        else:
            core = rate.catalogue
            parts += [
                f"`tryon catalogue`, {BLOCK} bodies a block: a core drapes {1 / core.drape:.3g} bodies a second, "
                "pushed out, measured and judged, or "
                f"{1 / core.alone:.3g} with neither (`--no-push-out --no-fit`); "
                f"a garment is prepared in {core.prepare:.2g} s for each block.",
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
    catalogues = load_catalogues(config.results)
    found = [rates(r, catalogues, config.cpu_price, config.gpu_price) for r in load_records(config.results)]
    known = [rate for rate in found if rate is not None]
    if not known:
        raise ValueError(f"no record in {str(config.results)!r} has timed a catalogue or a simulation")
    with resources.as_file(resources.files("tryon_jax") / "data" / "models" / "small.safetensors") as path:
        training = read_record(path).get("training", {})
    write_text(config.out, page(known, training, config))
    print(f"wrote {config.out} from {len(known)} records")
