"""Independent tasks on many processes: of this machine, or of any machines that a Dask scheduler knows.

Each task writes one file in one step and does nothing where the file exists. So it does not matter who does it or how
often it is begun: a lost worker's task is given to another, and what is done stays done.

Dask and not Ray: pure Python, a few MB, BSD-3-Clause, on every Python that the library supports, with starters for SSH,
SLURM and Kubernetes; Ray's object store and actors would have nothing to do here, since results are files.
"""

import errno
import hashlib
import importlib.util
import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tqdm import tqdm

ONE_CORE = {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "OPENBLAS_NUM_THREADS": "1",
}
"""Environment of a worker: the arrays are too small to share a thread pool, two processes are twice as fast. OpenBLAS,
which inverts the solver's coarse matrices, starts its threads with NumPy, before a worker can be bound to a core; after
each call they wait actively for a while, which took half of the worker's time."""

NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


def available_cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def open_pool(processes: int, scheduler: str = "") -> Iterator[Executor]:
    """An executor: `processes` processes of this machine, or the workers of the Dask scheduler at an address.

    Raises:
        ValueError: a scheduler is named and Dask is not installed, or nobody answers there.
    """
    if scheduler:
        with _dask_pool(scheduler) as pool:
            yield pool
        return
    os.environ.update(ONE_CORE)
    context = multiprocessing.get_context("spawn")
    turn = context.Value("i", 0)
    with ProcessPoolExecutor(processes, mp_context=context, initializer=_start_worker, initargs=(turn,)) as pool:
        try:
            yield pool
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            raise


def end_with_parent() -> None:
    """Let this worker end when the process that started it does, even if that is killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _start_worker(turn: Any) -> None:
    """Bind this worker to a core of its own, in turn, before JAX starts as many threads as it sees cores.

    XLA's flags alone do not prevent that, and threads of several workers that share cores wait for each other.
    """
    end_with_parent()
    if hasattr(os, "sched_setaffinity"):
        with turn.get_lock():
            number, turn.value = turn.value, turn.value + 1
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[number % len(cores)]})


@contextmanager
def _dask_pool(scheduler: str) -> Iterator[Executor]:
    if importlib.util.find_spec("distributed") is None:
        raise ValueError("scheduler needs Dask: pip install 'tryon_jax[distributed]'")
    from distributed import Client

    try:
        client = Client(scheduler, timeout=30)
    except (OSError, ValueError) as error:
        raise ValueError(f"scheduler = {scheduler!r}: {error}") from None
    with client:
        # Tasks have side effects: none may be taken for the repetition of another.
        pool = client.get_executor(pure=False)
        try:
            yield pool
        except KeyboardInterrupt:
            pool.shutdown(wait=False)
            raise


def run_all(
    pool: Executor, title: str, function: Callable[..., str], tasks: Sequence[tuple[Any, ...]], done: int = 0
) -> list[str]:
    """Call `function(*task)` for every task and return what went wrong, one line for each failed task.

    Args:
        pool: From `open_pool`.
        title: Of the progress bar.
        function: Of a module that the workers can import; returns a line about what it did.
        tasks: Arguments of each call.
        done: How many tasks were done before, for the bar.

    Raises:
        OSError: There is no space left: every other task would fail too, so none is begun any more.
    """
    failed = []
    with tqdm(total=done + len(tasks), initial=done, desc=title, unit="file", mininterval=2) as bar:
        futures = {pool.submit(function, *task): task for task in tasks}
        for future in as_completed(futures):
            bar.update()
            task, error = futures.pop(future), future.exception()
            if error is None:
                bar.set_postfix_str(future.result()[:90])
            else:
                if isinstance(error, OSError) and error.errno in NO_SPACE:
                    for future in futures:
                        future.cancel()
                    raise OSError(
                        error.errno, f"the disk is full: free space and run again, what is done stays done ({error})"
                    )
                failed.append(f"{task}: {error}")
                tqdm.write(f"failed: {failed[-1]}")
    return failed


def checksums(root: Path) -> str:
    """SHA-256 of every file below a folder, in the format of `sha256sum`, sorted by name."""
    paths = sorted(
        p for p in root.rglob("*") if p.is_file() and not p.name.startswith(".") and p.name != "checksums.txt"
    )
    return "".join(f"{hashlib.sha256(p.read_bytes()).hexdigest()}  {p.relative_to(root)}\n" for p in paths)
