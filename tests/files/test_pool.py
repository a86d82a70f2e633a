"""Tasks on many processes: the same files whoever makes them, a lost worker's task done again once."""

import sys
from collections import Counter
from pathlib import Path

import pytest
from pool_tasks import fail, write_number

from tryon_jax.files.pool import checksums, open_pool, run_all

COUNT = 12


def log(root: Path, what: str) -> Counter[int]:
    return Counter(map(int, (root / f"{what}.log").read_text().split()))


def test_same_checksums_whatever_the_number_of_workers(tmp_path):
    for workers in (1, 2):
        root = tmp_path / str(workers)
        root.mkdir()
        with open_pool(workers) as pool:
            assert run_all(pool, "files", write_number, [(str(root), k) for k in range(COUNT)]) == []
        assert log(root, "done") == dict.fromkeys(range(COUNT), 1)
    one, two = (checksums(tmp_path / str(w) / "files") for w in (1, 2))
    assert one == two
    assert len(one.splitlines()) == COUNT


def test_failures_are_named_and_do_not_stop_the_rest(tmp_path):
    with open_pool(1) as pool:
        failed = run_all(pool, "files", fail, [(str(tmp_path), 7)])
        assert run_all(pool, "files", write_number, [(str(tmp_path), 1)]) == []
    assert len(failed) == 1
    assert "7 cannot be done" in failed[0]


@pytest.fixture(scope="module")
def cluster():
    """Two Dask workers, one thread each, in processes of their own."""
    distributed = pytest.importorskip("distributed", exc_type=ImportError)
    path = [str(Path(__file__).parent), *sys.path]
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, memory_limit=0, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.run(sys.path.extend, path)
        yield cluster


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_killed_workers_task_is_done_again_exactly_once(cluster, tmp_path):
    tasks = [(str(tmp_path), k, 5) for k in range(COUNT)]
    with open_pool(0, cluster.scheduler_address) as pool:
        assert run_all(pool, "files", write_number, tasks) == []
    assert (tmp_path / "killed").exists()
    assert log(tmp_path, "done") == dict.fromkeys(range(COUNT), 1)
    assert log(tmp_path, "begun") == {k: 2 if k == 5 else 1 for k in range(COUNT)}
    root = tmp_path / "local"
    root.mkdir()
    for k in range(COUNT):
        write_number(str(root), k)
    assert checksums(tmp_path / "files") == checksums(root / "files")


def test_nobody_at_the_address(tmp_path):
    pytest.importorskip("distributed", exc_type=ImportError)
    with pytest.raises(ValueError, match="scheduler = 'no-scheme://x'"), open_pool(1, "no-scheme://x"):
        pass
