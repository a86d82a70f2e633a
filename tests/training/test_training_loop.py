"""The resumable loop on a problem whose answer is known."""

import os
import signal

import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.training import loop
from tryon_jax.training.checkpoint import load_checkpoint
from tryon_jax.training.loop import LoopOptions, LoopResult, OutOfTimeError, TimeLimits, train_loop

TARGET = np.array([1.0, -2.0, 0.5], np.float32)


def run(
    folder, steps=120, stop_at=None, seed=0, identity=None, signal_at=None, limits=None, each=lambda: None
) -> LoopResult:
    """Fit a vector to noisy observations; `stop_at` breaks off after so many batches, `signal_at` sends a signal."""
    drawn = 0

    def draw(rng: np.random.Generator):
        nonlocal drawn
        drawn += 1
        each()
        if stop_at is not None and drawn > stop_at:
            raise KeyboardInterrupt
        if signal_at is not None and drawn == signal_at[0]:
            os.kill(os.getpid(), signal_at[1])
        return jnp.asarray(TARGET + 0.1 * rng.normal(size=3).astype(np.float32))

    def loss(params, batch):
        return ((params["x"] - batch) ** 2).sum()

    def evaluate(params) -> float:
        return float(np.abs(np.asarray(params["x"]) - TARGET).max())

    options = LoopOptions(steps=steps, learning_rate=0.1, warmup=5, weight_decay=0.0, evaluate_every=20, seed=seed)
    start = {"x": jnp.zeros(3)}
    return train_loop(start, loss, draw, evaluate, folder, options, identity or {"run": "toy"}, limits=limits)


def test_finds_the_minimum_and_writes_its_curve(tmp_path):
    result = run(tmp_path)
    assert np.allclose(result.params["x"], TARGET, atol=0.05)
    lines = (tmp_path / "curve.csv").read_text().splitlines()
    assert lines[0] == "step,loss,validation,seconds,step_ms,draw_ms,cores"
    assert [int(line.split(",")[0]) for line in lines[1:]] == list(range(20, 121, 20))


def test_interrupted_and_resumed_equals_unbroken(tmp_path):
    unbroken = run(tmp_path / "a")
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "b", stop_at=70)
    resumed = run(tmp_path / "b")
    assert np.array_equal(unbroken.params["x"], resumed.params["x"])
    for one, other in zip(unbroken.curve, resumed.curve, strict=True):
        assert one["step"] == other["step"]
        assert one["validation"] == other["validation"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("step", [5, 20, 33])
def test_a_polite_stop_loses_no_step(tmp_path, number, step):
    """Ctrl-C, or `timeout`: the step at hand is finished and kept, whether or not it is one that evaluates."""
    # Python's own handlers, or "ignored" in a job that a shell started in the background.
    before = signal.getsignal(number)
    unbroken = run(tmp_path / "a", steps=60)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "b", steps=60, signal_at=(step, number))
    arrays = np.load(tmp_path / "b" / "checkpoint.npz")
    assert f'"step": {step}' in str(arrays["progress"])
    resumed = run(tmp_path / "b", steps=60)
    assert np.array_equal(unbroken.params["x"], resumed.params["x"])
    for one, other in zip(unbroken.curve, resumed.curve, strict=True):
        assert (one["step"], one["loss"], one["validation"]) == (other["step"], other["loss"], other["validation"])
    assert signal.getsignal(number) == before


class Clock:
    """Seconds that pass only when told to."""

    def __init__(self) -> None:
        self.now = 0.0

    def tick(self) -> None:
        self.now += 1.0


@pytest.mark.parametrize("deadline", [5.0, 20.0, 33.0])
def test_time_that_is_over_loses_no_step(tmp_path, monkeypatch, deadline):
    unbroken, clock = run(tmp_path / "a"), Clock()
    monkeypatch.setattr(loop.time, "monotonic", lambda: clock.now)
    with pytest.raises(OutOfTimeError, match=f"at step {deadline:.0f} of 120"):
        run(tmp_path / "b", limits=TimeLimits(deadline), each=clock.tick)
    resumed = run(tmp_path / "b")
    assert np.array_equal(unbroken.params["x"], resumed.params["x"])
    assert [row["loss"] for row in unbroken.curve] == [row["loss"] for row in resumed.curve]


def test_checkpoints_are_written_between_evaluations(tmp_path, monkeypatch):
    clock = Clock()
    monkeypatch.setattr(loop.time, "monotonic", lambda: clock.now)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, stop_at=17, limits=TimeLimits(checkpoint_seconds=6.5), each=clock.tick)
    saved = load_checkpoint(tmp_path)
    assert saved is not None
    assert saved[1]["step"] == 14


def test_finished_run_is_not_run_again(tmp_path):
    first = run(tmp_path)
    again = run(tmp_path, stop_at=0)
    assert np.array_equal(first.params["x"], again.params["x"])


def test_keeps_the_best_weights_not_the_last(tmp_path):
    errors = iter([0.5, 0.1, 0.9, 0.8, 0.7, 0.6])
    seen = []

    def evaluate(params) -> float:
        seen.append(float(params["x"]))
        return next(errors)

    options = LoopOptions(steps=60, learning_rate=0.1, evaluate_every=10)
    result = train_loop(
        {"x": jnp.zeros(())}, lambda p, b: (p["x"] - b) ** 2, lambda _: 1.0, evaluate, tmp_path, options, {}
    )
    assert float(result.params["x"]) == seen[1]


def test_patience_stops_early(tmp_path):
    options = LoopOptions(steps=100, evaluate_every=10, patience=3)
    result = train_loop(
        {"x": jnp.zeros(())}, lambda p, b: (p["x"] - b) ** 2, lambda _: 1.0, lambda _: 1.0, tmp_path, options, {}
    )
    assert result.curve[-1]["step"] == 40


def test_folder_of_another_run_is_refused(tmp_path):
    run(tmp_path, steps=20)
    with pytest.raises(ValueError, match="holds another run: run differ"):
        run(tmp_path, steps=20, identity={"run": "other"})


def test_checkpoint_of_another_network_is_refused(tmp_path):
    run(tmp_path, steps=20)
    options = LoopOptions(steps=40, evaluate_every=20)
    with pytest.raises(ValueError, match="another network"):
        train_loop(
            {"x": jnp.zeros(5)},
            lambda p, _: p["x"].sum(),
            lambda _: 0.0,
            lambda _: 0.0,
            tmp_path,
            options,
            {"run": "toy"},
        )


def test_damaged_checkpoint_is_named(tmp_path):
    run(tmp_path, steps=20)
    data = (tmp_path / "checkpoint.npz").read_bytes()
    (tmp_path / "checkpoint.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match="damaged"):
        run(tmp_path, steps=40)


def test_nan_loss_stops(tmp_path):
    options = LoopOptions(steps=20, evaluate_every=10)
    with pytest.raises(ValueError, match="loss became nan"):
        train_loop(
            {"x": jnp.zeros(())},
            lambda p, _: p["x"] * jnp.nan,
            lambda _: jnp.zeros(()),
            lambda _: 0.0,
            tmp_path,
            options,
            {},
        )


def test_muon_solves_for_a_stack_of_matrices(tmp_path):
    wanted = jnp.asarray(np.random.default_rng(0).normal(size=(2, 4, 3)), jnp.float32)

    def draw(rng: np.random.Generator):
        return jnp.asarray(rng.normal(size=(2, 16, 4)), jnp.float32)

    def loss(params, batch):
        return ((jnp.einsum("kbi,kio->kbo", batch, params["weight"] - wanted) + params["bias"][None, None]) ** 2).mean()

    options = LoopOptions(steps=300, learning_rate=0.1, optimiser="muon", weight_decay=0.0, evaluate_every=300)
    start = {"weight": jnp.zeros((2, 4, 3)), "bias": jnp.ones(3)}
    result = train_loop(
        start, loss, draw, lambda p: float(abs(p["weight"] - wanted).max()), tmp_path, options, {"run": "matrices"}
    )
    assert result.curve[-1]["validation"] < 0.05
