"""One resumable optimisation loop for every network: atomic checkpoints, curves, the best weights kept.

Batches are drawn by step number, so a run that was stopped and resumed sees what an unbroken one would have seen.
"""

import contextlib
import csv
import io
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax
import optax.contrib
from tqdm import tqdm

from tryon_jax.files.atomic import write_text
from tryon_jax.training.checkpoint import load_checkpoint, save_checkpoint
from tryon_jax.training.interrupts import stop_requests
from tryon_jax.training.parallel import SingleDevice, visible_devices
from tryon_jax.training.parts import Batch, Params, default_shapes_at_once, value_and_grad_in_parts


@dataclass(frozen=True)
class LoopOptions:
    """How long and how fast; the same for all stages."""

    steps: int = 8000
    """Optimiser steps in all."""
    optimiser: Literal["adamw", "muon"] = "adamw"
    """muon: orthogonalised momentum (Jordan et al. 2024) for the convolutions' matrices, AdamW for the rest."""
    learning_rate: float = 2e-3
    """At the start of a cosine decay to 2 %, after a short warm-up."""
    bias_rate: float = 0.1
    """Under Muon, learning rate of the biases, which AdamW moves, over that of the matrices: with one rate for both,
    the loss jumped now and then and took a thousand steps to recover."""
    warmup: int = 50
    weight_decay: float = 1e-5
    """ℓ² regularisation of the weights (decoupled, as in AdamW)."""
    clip: float = 1.0
    """Bound on the gradient's global norm."""
    evaluate_every: int = 500
    patience: int = 0
    """Stop after so many evaluations without a new best; 0 never stops early."""
    seed: int = 0
    shapes_at_once: int | None = None
    """Body shapes of a garment whose gradient is computed at once, 0 for all of a batch; by default 1 on a CPU, where
    that is more than twice as fast (`benchmarks training`), and all elsewhere."""


@dataclass(frozen=True)
class TimeLimits:
    """How long one run of a loop may take and how often it writes; what it computes does not depend on them."""

    deadline: float = np.inf
    """Of `time.monotonic()`: then the step at hand is finished and a checkpoint written."""
    checkpoint_seconds: float = np.inf
    """Time after which a checkpoint is written between evaluations."""


class OutOfTimeError(RuntimeError):
    """The deadline came before the last step; the same call continues from the checkpoint."""


@dataclass(frozen=True, eq=False)
class LoopResult:
    """What a loop ends with."""

    params: Params
    """Weights with the smallest validation error."""
    curve: list[dict[str, float]]
    """One row for each evaluation: step, loss, validation error, seconds, and since the row before milliseconds per
    step, milliseconds of it spent drawing the batch on the host (the device computes meanwhile), cores in use."""
    seconds: float
    """Time spent in all runs together."""


def train_loop(
    params: Params,
    loss: Callable[[Params, Batch], jax.Array],
    draw: Callable[[np.random.Generator], Batch],
    evaluate: Callable[[Params], float],
    folder: Path,
    options: LoopOptions,
    identity: dict[str, Any],
    title: str = "training",
    devices: SingleDevice | None = None,
    limits: TimeLimits | None = None,
) -> LoopResult:
    """Minimise `loss` by AdamW.

    Args:
        params: starting weights.
        loss: of weights and a batch, a mean over its garments and body shapes; compiled once for each shape of batch.
        draw: makes a batch from a random generator (host side).
        evaluate: validation error of weights, smaller is better.
        folder: keeps checkpoint, curve.csv and record.json; a run continues from what lies there.
        options: see `LoopOptions`.
        identity: what the run depends on (configuration, dataset checksum); a folder of another run is refused.
        title: of the progress bar.
        devices: what it runs on; all visible devices by default (see `parallel`).
        limits: of this run; none by default.

    Raises:
        OutOfTimeError: the deadline of `limits` came; a checkpoint is written.
        KeyboardInterrupt: after Ctrl-C or SIGTERM, when the step at hand is done and a checkpoint is written.
        ValueError: the folder belongs to another run, or the loss became NaN.
    """
    schedule = optax.warmup_cosine_decay_schedule(
        0.0, options.learning_rate, min(options.warmup, options.steps // 2), options.steps, 0.02 * options.learning_rate
    )
    optimiser = optax.chain(optax.clip_by_global_norm(options.clip), _optimiser(schedule, options))

    devices = devices or visible_devices()
    at_once = default_shapes_at_once() if options.shapes_at_once is None else options.shapes_at_once
    value_and_grad = devices.average(value_and_grad_in_parts(loss, at_once))

    @jax.jit
    def update(params: Params, state: Any, batch: Batch) -> tuple[Params, Any, jax.Array]:
        value, gradient = value_and_grad(params, batch)
        updates, state = optimiser.update(gradient, state, params)
        return optax.apply_updates(params, updates), state, value

    tree = (params, optimiser.init(params), params)
    progress: dict[str, Any] = {"curve": [], "step": 0, "seconds": 0.0}
    if devices.is_main:
        _check_identity(folder, identity)
        tree, progress = _load(folder, tree, progress)
    params, state, best = devices.replicate(devices.agree_arrays(tree))
    progress = devices.agree(progress)
    curve, done, seconds = progress["curve"], progress["step"], progress["seconds"]
    losses: list[Any] = progress.get("losses", [])
    began = saved = time.monotonic()
    limits = limits or TimeLimits()
    pace = _Pace()

    def save() -> None:
        if devices.is_main:
            total = seconds + time.monotonic() - began
            kept = {"curve": curve, "step": done, "seconds": total, "losses": _floats(losses)}
            _save(folder, devices.local((params, state, best)), kept)

    def late() -> bool:
        return limits.deadline < np.inf and devices.agree(time.monotonic() >= limits.deadline)

    hidden = not devices.is_main
    with (
        stop_requests() as stopped,
        tqdm(total=options.steps, initial=done, desc=title, unit="step", mininterval=2, disable=hidden) as bar,
    ):
        while done < options.steps and not _stalled(curve, options.patience):
            with pace.drawing():
                batch = devices.split(draw(np.random.default_rng((options.seed, done))))
            params, state, value = update(params, state, batch)
            losses.append(value)
            done += 1
            bar.update()
            if done % options.evaluate_every and done != options.steps:
                if stopped():
                    save()
                    raise KeyboardInterrupt
                if late():
                    save()
                    raise OutOfTimeError(f"{title}: time was over at step {done} of {options.steps}")
                if time.monotonic() - saved > limits.checkpoint_seconds:
                    save()
                    saved = time.monotonic()
                continue
            mean_loss = float(np.mean(np.array(_floats(losses), np.float32)))
            if not np.isfinite(mean_loss):
                raise ValueError(f"the training loss became {mean_loss} at step {done}; use a smaller learning rate")
            measured = pace.since_last(len(losses))
            losses = []
            error = devices.agree(evaluate(devices.local(params)))
            if not curve or error < min(row["validation"] for row in curve):
                best = params
            total = seconds + time.monotonic() - began
            row = {"step": done, "loss": mean_loss, "validation": error, "seconds": round(total, 1)}
            curve.append(row | measured)
            bar.set_postfix({"loss": f"{mean_loss:.4f}", "validation": f"{error:.4f}", **measured})
            pace.restart()
            save()
            saved = time.monotonic()
            if devices.is_main:
                write_text(folder / "curve.csv", _as_csv(curve))
            if stopped() and done < options.steps:
                raise KeyboardInterrupt
            if done < options.steps and late():
                raise OutOfTimeError(f"{title}: time was over at step {done} of {options.steps}")
    return LoopResult(devices.local(best), curve, seconds + time.monotonic() - began)


class _Pace:
    """Where the time of the steps since the last evaluation went."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin to count."""
        self._wall, self._cpu, self._drawing = time.monotonic(), time.process_time(), 0.0

    @contextlib.contextmanager
    def drawing(self) -> Iterator[None]:
        """Counts what happens inside as drawing a batch."""
        start = time.monotonic()
        yield
        self._drawing += time.monotonic() - start

    def since_last(self, steps: int) -> dict[str, float]:
        """Columns of the curve."""
        wall, cpu = time.monotonic() - self._wall, time.process_time() - self._cpu
        count = max(steps, 1)
        return {
            "step_ms": round(1e3 * wall / count, 2),
            "draw_ms": round(1e3 * self._drawing / count, 2),
            "cores": round(cpu / max(wall, 1e-9), 2),
        }


def _optimiser(schedule: optax.Schedule, options: LoopOptions) -> optax.GradientTransformation:
    if options.optimiser == "adamw":
        return optax.adamw(schedule, weight_decay=options.weight_decay)

    def matrices(params: Params) -> Params:
        # Convolutions are [K, inputs, outputs]: one matrix for each Chebyshev order.
        dimensions = optax.contrib.MuonDimensionNumbers((1,), (2,))
        return jax.tree.map(lambda leaf: dimensions if jnp.ndim(leaf) == 3 else None, params)

    return optax.contrib.muon(
        schedule,
        weight_decay=options.weight_decay,
        adam_learning_rate=lambda step: options.bias_rate * schedule(step),
        muon_weight_dimension_numbers=matrices,
    )


def _stalled(curve: list[dict[str, float]], patience: int) -> bool:
    if not patience or len(curve) <= patience:
        return False
    errors = [row["validation"] for row in curve]
    return min(errors[-patience:]) >= min(errors[:-patience])


def _check_identity(folder: Path, identity: dict[str, Any]) -> None:
    path = folder / "record.json"
    wanted = json.loads(json.dumps(identity))
    if not path.exists():
        write_text(path, json.dumps(wanted, indent=2) + "\n")
    found = json.loads(path.read_text())
    different = sorted(key for key in {*found, *wanted} if found.get(key) != wanted.get(key))
    if different:
        key = different[0]
        raise ValueError(
            f"{str(folder)!r} holds another run: {', '.join(different)} differ "
            f"({key} = {found.get(key)!r}, asked for {wanted.get(key)!r}); choose another folder or delete it"
        )


def _floats(losses: list[Any]) -> list[float]:
    """Losses as numbers: those of steps before a stop are numbers already."""
    return [float(value) for value in jax.device_get(losses)]


def _save(folder: Path, tree: tuple[Params, Any, Params], progress: dict[str, Any]) -> None:
    save_checkpoint(folder, [np.asarray(leaf) for leaf in jax.tree.leaves(tree)], progress)


def _load(
    folder: Path, tree: tuple[Params, Any, Params], progress: dict[str, Any]
) -> tuple[tuple[Params, Any, Params], dict[str, Any]]:
    """Weights, optimiser state, best weights and progress of a run, or what is given where it has not begun."""
    saved = load_checkpoint(folder)
    if saved is None:
        return tree, progress
    leaves, progress = saved
    old, structure = jax.tree.flatten(tree)
    if len(leaves) != len(old) or any(a.shape != np.shape(b) for a, b in zip(leaves, old, strict=True)):
        raise ValueError(f"the checkpoint in {str(folder)!r} is of another network; delete it to start anew")
    return jax.tree.unflatten(structure, [jnp.asarray(leaf) for leaf in leaves]), progress


def _as_csv(curve: list[dict[str, float]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(curve[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(curve)
    return text.getvalue()
