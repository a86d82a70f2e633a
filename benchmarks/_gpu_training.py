"""What is left of a GPU's time trains: R_mean, R_smooth, R_fine of each fabric, continued from run to run."""

import csv
import json
import multiprocessing
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import numpy as np

from tryon_jax.garment import load_design_space
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.nets.config import Size, load_config
from tryon_jax.nets.store import read_record
from tryon_jax.training.dataset import read_config
from tryon_jax.training.garments import SimulatedGarment, prepare_simulated
from tryon_jax.training.loop import OutOfTimeError, TimeLimits
from tryon_jax.training.mean import MeanTraining
from tryon_jax.training.protocol import EXTENT
from tryon_jax.training.recipes import fit_fine, fit_mean, fit_smooth, load_fine_sets
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_prediction import Predictor, validation_error
from tryon_jax.training.training_set import dataset_checksum, load_samples, training_names
from tryon_jax.tryon import Garment, TryOnModel, load_model

LEAST_SECONDS = 5.0
"""Nothing is begun with less time than this."""


@dataclass(frozen=True)
class Training:
    """How the networks are trained; a run folder belongs to one choice of these."""

    size: Size = "paper"
    """Configuration of the networks."""
    steps: int = 6000
    """Steps of each stage: R_smooth, and R_fine of each fabric."""
    mean_steps: int = 6000
    """Steps of R_mean."""
    garments: int = 4
    """Garments in a batch."""
    shapes: int = 16
    """Body shapes of each garment in a batch."""
    evaluate_every: int = 500
    """Steps from one validation to the next."""
    checkpoint_seconds: float = 60.0
    """Time after which a checkpoint is written."""
    processes: int = os.cpu_count() or 1
    """Processes that prepare the garments on the host; 1: this one."""


def check_data(data: Path, run: Path) -> None:
    """Say at once what would be found out minutes later.

    Raises:
        FileNotFoundError: there is no data set in the folder.
        ValueError: it has no garment to train on, or the run was begun with another one.
    """
    names = training_names(data, load_manifest())
    if not names:
        raise ValueError(f"data = {str(data)!r} has no garment that may be trained on")
    for path in sorted(run.glob("*/record.json")):
        begun = json.loads(path.read_text()).get("dataset")
        if begun != dataset_checksum(data, names):
            raise ValueError(f"{str(run)!r} was begun with another data set than {str(data)!r}; choose another folder")


def train(data: Path, run: Path, training: Training, seconds: float) -> dict[str, Any]:
    """Train for so many seconds, from where the last run stopped.

    Returns:
        What state the training is in, the last row of each stage's curve, and, where all is trained, how it compares
        with the weights that come with the package.
    """
    deadline = time.monotonic() + seconds
    manifest, fabrics = load_manifest(), read_config(data).fabrics
    found: dict[str, Any] = {"data": data.name, "stages": {}, "compared": []}
    if seconds < LEAST_SECONDS:
        return found | {"state": f"not begun: {max(seconds, 0.0):.0f} s were left", "stages": _rows(run, fabrics)}
    if not (run / "mean" / "curve.json").exists():
        fit_mean(data, run, network(data, training.size), MeanTraining(steps=training.mean_steps))
    names = training_names(data, manifest)
    options = StageOptions()
    every = min(training.evaluate_every, training.steps)
    loop = replace(options.loop, steps=training.steps, evaluate_every=every)
    options = replace(options, loop=loop, garments=training.garments, shapes=training.shapes)
    limits = TimeLimits(deadline, training.checkpoint_seconds)
    samples: list[SimulatedGarment] | None = None
    state = f"all stages have their {training.steps} steps"
    try:
        for stage in ("smooth", *(f"fine-{fabric}" for fabric in fabrics)):
            if trained(run, stage) >= training.steps:
                continue
            if time.monotonic() > deadline - LEAST_SECONDS:
                raise OutOfTimeError(f"{stage}: not begun, time was over")
            if samples is None:
                samples = load_prepared(data, model_path(run), names, training.processes)
            if stage == "smooth":
                fit_smooth(data, run, options, samples, limits)
            else:
                fabric = stage.removeprefix("fine-")
                fit_fine(data, run, [fabric], options, samples=samples, limits=limits)
    except OutOfTimeError as over:
        return found | {"state": str(over), "stages": _rows(run, fabrics)}
    if time.monotonic() < deadline - LEAST_SECONDS:
        found["compared"] = compared(data, model_path(run), samples, names, training.processes)
    else:
        found["compared"] = ["compared with the weights of the package by the next run"]
    return found | {"state": state, "stages": _rows(run, fabrics)}


def network(data: Path, size: Size) -> Any:
    """The configuration of the networks for a data set."""
    dataset = read_config(data)
    return load_config(
        size,
        body=dataset.body,
        layout=dataset.layout,
        fabrics=dataset.fabrics,
        num_betas=dataset.num_betas,
        beta_extent=EXTENT[: dataset.num_betas],
        target_area=dataset.target_area,
        num_parameters=len(load_design_space(dataset.layout).names),
    )


def trained(run: Path, stage: str) -> int:
    """Steps after which a stage's weights were put into the model; 0 for none."""
    return int(read_record(model_path(run)).get("training", {}).get(stage, {}).get("steps", 0))


def load_prepared(data: Path, weights: Path, names: Sequence[str], processes: int) -> list[SimulatedGarment]:
    """The garments with their drapes; graphs are built by many processes, a GPU's host has the cores."""
    model = load_model(weights)
    if processes == 1:
        return load_samples(model, data, names)
    with _on_cpus(), ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        jobs = [pool.submit(_prepare, str(weights), str(data), name) for name in names]
        prepared = {name: job.result() for name, job in zip(names, jobs, strict=True)}
    return load_samples(model, data, names, prepared)


_HOST_ALONE = {
    "JAX_PLATFORMS": "cpu",
    "OPENBLAS_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}


@contextmanager
def _on_cpus() -> Iterator[None]:
    """Processes that are started inside leave the card alone and keep to one core each."""
    before = {name: os.environ.get(name) for name in _HOST_ALONE}
    os.environ.update(_HOST_ALONE)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            os.environ.update({} if value is None else {name: value})


@cache
def _model(weights: str) -> TryOnModel:
    return load_model(Path(weights))


def _prepare(weights: str, data: str, name: str) -> Garment:
    return jax.tree.map(np.asarray, prepare_simulated(_model(weights), Path(data), name))


def shipped_weights() -> AbstractContextManager[Path]:
    """File of the weights that come with the package."""
    return resources.as_file(resources.files("tryon_jax") / "data" / "models" / "small.safetensors")


def compared(
    data: Path, weights: Path, samples: list[SimulatedGarment] | None, names: Sequence[str], processes: int
) -> list[str]:
    """One line for each fabric: error on validation drapes of the trained networks and of those in the package."""
    lines = []
    with shipped_weights() as shipped:
        own = load_model(weights), samples or load_prepared(data, weights, names, processes)
        other = load_model(shipped), load_prepared(data, shipped, names, processes)
    for fabric in own[0].config.fabrics:
        if fabric not in other[0].config.fabrics:
            continue
        errors = []
        for model, prepared in (own, other):
            sets, _ = load_fine_sets(model, data, fabric, StageOptions(), prepared)
            errors.append(validation_error(Predictor(model.config, "fine"), model.fine[fabric], sets))
        better = "better" if errors[0] < errors[1] else "no better"
        lines.append(
            f"{fabric}: {errors[0]:.3f} mm on validation drapes, the package's weights {errors[1]:.3f} mm: {better}"
        )
    return lines


def _rows(run: Path, fabrics: Sequence[str]) -> dict[str, Any]:
    """Last row of each curve; R_mean's best."""
    rows: dict[str, Any] = {}
    mean = run / "mean" / "curve.json"
    if mean.exists():
        rows["mean"] = {"validation": json.loads(mean.read_text())["validation_mm"]}
    for stage in ("smooth", *(f"fine-{fabric}" for fabric in fabrics)):
        curve = run / stage / "curve.csv"
        if curve.exists():
            last = list(csv.DictReader(curve.read_text().splitlines()))[-1]
            rows[stage] = {name: float(value) for name, value in last.items()}
    return rows
