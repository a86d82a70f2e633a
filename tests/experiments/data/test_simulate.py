"""Simulating as a command: a full disk, what killed writers leave, a run that is killed and started again."""

import csv
import errno
import hashlib
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tryon_jax.files.pool import run_all
from tryon_jax.training.dataset import remove_leftovers

ROOT = Path(__file__).parents[3]


def test_a_full_disk_stops_the_work_at_once() -> None:
    begun = []

    def write(number: int) -> str:
        begun.append(number)
        time.sleep(0.05)
        if number == 1:
            raise OSError(errno.ENOSPC, "No space left on device", "rays/x.npz")
        return "done"

    with ThreadPoolExecutor(1) as pool, pytest.raises(OSError, match=r"disk is full: free space .*rays/x\.npz"):
        run_all(pool, "files", write, [(k,) for k in range(40)])
    assert len(begun) < 10


def test_leftovers_of_killed_writers_go_when_they_are_old(tmp_path: Path) -> None:
    (tmp_path / "rays").mkdir()
    names = ("rays/.tshirt-0-abc.npz", "rays/.tshirt-1-abc.npz", "rays/tshirt-0.npz", ".config-x.json")
    for name in names:
        (tmp_path / name).write_bytes(b"")
        os.utime(tmp_path / name, (time.time() - 7200,) * 2)
    os.utime(tmp_path / names[1])
    assert remove_leftovers(tmp_path) == 1
    assert sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()) == sorted(names[1:])


@pytest.mark.slow
def test_killed_and_started_again_nothing_is_lost_or_doubled(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "experiments", "simulate", "--out", str(tmp_path / "set"), "--scale", "small"]
    command += ["--betas", "1", "--rays", "0", "--processes", "1"]
    surroundings = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)])}
    mean = tmp_path / "set" / "mean"
    with subprocess.Popen(command, env=surroundings, stderr=subprocess.PIPE, start_new_session=True) as process:
        while process.poll() is None and not any(mean.glob("t*.npz")):
            time.sleep(0.2)
        os.killpg(process.pid, signal.SIGKILL)
    first = {path.name: path.stat().st_mtime_ns for path in mean.glob("t*.npz")}
    assert 1 <= len(first) < 4
    finished = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
    found = {path.name: path.stat().st_mtime_ns for path in mean.glob("t*.npz")}
    assert len(found) == 4
    assert first.items() <= found.items()
    lines = list(csv.DictReader((tmp_path / "set" / "samples.csv").read_text().splitlines()))
    assert sorted(line["file"] for line in lines) == sorted(f"mean/{name}" for name in found)
    assert {line["betas"] for line in lines} == {"0"}
    for line in (tmp_path / "set" / "checksums.txt").read_text().splitlines():
        digest, name = line.split("  ", 1)
        assert hashlib.sha256((tmp_path / "set" / name).read_bytes()).hexdigest() == digest
