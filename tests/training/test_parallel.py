"""Training over several devices and several processes is training on one, to rounding, and ends when one is lost."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from jax.sharding import PartitionSpec as P

from tests.kept_programs import kept_programs
from tryon_jax.training.parallel import DataParallel, joined_processes, partition
from tryon_jax.types import pytree

WORKER = Path(__file__).with_name("parallel_worker.py")
PATIENCE = 900
"""Seconds until a process counts as hanging."""


def start(task: dict, virtual_devices: int = 1) -> subprocess.Popen:
    flags = f"--xla_force_host_platform_device_count={virtual_devices}"
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "XLA_FLAGS": flags, "OMP_NUM_THREADS": "1"} | kept_programs()
    # The network is small: optimising its programs would take longer than running them.
    environment["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
    command = [sys.executable, str(WORKER), json.dumps(task)]
    return subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    )


def finish(processes: list[subprocess.Popen]) -> list[tuple[int, str, str]]:
    """Exit code, output and errors of each; none may hang."""
    try:
        return [(p.returncode, *texts) for p in processes if (texts := p.communicate(timeout=PATIENCE)) is not None]
    finally:
        for p in processes:
            if p.poll() is None:
                p.kill()
                p.communicate()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def together(folder: Path, **task: object) -> list[tuple[int, str, str]]:
    """Two processes over loopback."""
    task |= {"folder": str(folder), "coordinator": f"localhost:{free_port()}", "processes": 2}
    return finish([start(task | {"process": number}) for number in (0, 1)])


def assert_same_run(one: dict, other: dict) -> None:
    """The stated tolerance: losses and errors to 1e-5, the sum over all weights to 1e-5."""
    assert [row["step"] for row in one["curve"]] == [row["step"] for row in other["curve"]]
    for key in ("loss", "validation"):
        np.testing.assert_allclose([r[key] for r in one["curve"]], [r[key] for r in other["curve"]], rtol=1e-5)
    np.testing.assert_allclose(one["weights"], other["weights"], rtol=1e-5)


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> dict[int, dict]:
    """The same training on 1, 2 and 4 virtual devices."""
    folder = str(tmp_path_factory.mktemp("devices"))
    [(code, output, errors)] = finish([start({"folder": folder, "devices": [1, 2, 4]}, virtual_devices=4)])
    assert code == 0, errors
    return {run["devices"]: run for run in json.loads(output.splitlines()[-1])}


@pytest.mark.slow
@pytest.mark.parametrize("devices", [2, 4])
def test_several_devices_train_as_one(runs, devices):
    assert_same_run(runs[1], runs[devices])
    first, *_, last = runs[devices]["curve"]
    assert last["validation"] < first["validation"]


@pytest.mark.slow
def test_two_processes_train_as_one_and_a_lost_one_ends_the_run(runs, tmp_path):
    broken = together(tmp_path, die_at=6)
    assert broken[1][0] == -9
    assert broken[0][0] not in (0, None), broken[0]
    progress = json.loads(str(np.load(tmp_path / "run" / "checkpoint.npz")["progress"]))
    assert progress["step"] == 4
    resumed = together(tmp_path)
    for code, output, errors in resumed:
        assert code == 0, errors
        [run] = json.loads(output.splitlines()[-1])
        assert run["devices"] == 2
        assert_same_run(runs[1], run)
    # Nothing is left of the broken run but what the unbroken one would have left.
    assert sorted(p.name for p in (tmp_path / "run").iterdir()) == ["checkpoint.npz", "curve.csv", "record.json"]


def test_wrong_numbers_are_named():
    for coordinator, processes, process, message in (
        ("localhost:1234", 2, 2, "process = 2 is outside its range 0 to 1"),
        ("localhost:1234", 0, 0, "processes = 0"),
        ("localhost", 2, 0, "must be host:port"),
    ):
        with pytest.raises(ValueError, match=message), joined_processes(coordinator, processes, process):
            pass


def test_shapes_that_cannot_be_split_are_named():
    @pytree
    class Batch:
        BY_SHAPE = ("betas",)
        common: np.ndarray
        betas: np.ndarray

    class ThreeDevices:
        size = 3

    devices = DataParallel(jax.devices()[:1])
    devices.mesh = ThreeDevices()
    batch = Batch(np.zeros((2, 5)), np.zeros((2, 8, 2)))
    assert partition(batch) == [P(), P(None, "data")]
    with pytest.raises(ValueError, match="8 body shapes in a batch cannot be split over 3 devices"):
        devices.split(batch)
