"""Tasks for test_pool.py, in a module that worker processes can import."""

import os
import signal
import time
from pathlib import Path

from tryon_jax.files.atomic import write_text


def write_number(root: str, number: int, victim: int = -1) -> str:
    """Write one file, slowly, and say in a log what was begun; the first try at `victim` kills its process."""
    folder = Path(root)
    path = folder / "files" / f"{number}.txt"
    if path.exists():
        return ""
    _log(folder, "begun", number)
    time.sleep(0.05)
    killed = folder / "killed"
    if number == victim and not killed.exists():
        killed.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    write_text(path, f"{number * number}\n")
    _log(folder, "done", number)
    return f"{number} squared"


def fail(root: str, number: int) -> str:
    """A task that cannot be done."""
    raise ValueError(f"{number} cannot be done in {Path(root).name}")


def _log(folder: Path, what: str, number: int) -> None:
    with (folder / f"{what}.log").open("a") as log:
        log.write(f"{number}\n")
