"""Compiled programs are kept, within bounds, where the user wants it, and used again."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tryon_jax.files import compile_cache
from tryon_jax.files.compile_cache import cache_folder, keep_compiled_programs, prune


@pytest.fixture(autouse=True)
def nothing_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TRYON_JAX_CACHE", raising=False)
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)


def test_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TRYON_JAX_CACHE", str(tmp_path / "mine"))
    assert cache_folder().parent == tmp_path / "mine"
    # Another processor has a folder of its own.
    here = cache_folder()
    monkeypatch.setattr(compile_cache, "_processor", lambda: "another")
    assert cache_folder() != here


def test_it_is_off_unless_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    assert keep_compiled_programs() is None
    monkeypatch.setenv("TRYON_JAX_CACHE", "/somewhere")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "/elsewhere")
    assert keep_compiled_programs() is None


def test_a_folder_that_cannot_be_written_is_no_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TRYON_JAX_CACHE", str(tmp_path / "file" / "below"))
    assert keep_compiled_programs() is None


def test_the_oldest_go_first(tmp_path: Path) -> None:
    for age, name in enumerate(("new", "older", "oldest")):
        (tmp_path / name).write_bytes(bytes(100))
        os.utime(tmp_path / name, (1e9 - age,) * 2)
    assert prune(tmp_path, 250) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "older"]
    assert prune(tmp_path, 250) == 0


@pytest.mark.slow
def test_a_second_process_compiles_nothing(tmp_path: Path) -> None:
    script = """
from tryon_jax.files import compile_cache
compile_cache.LEAST_SECONDS = 0.0
assert compile_cache.keep_compiled_programs() is not None
import jax, jax.numpy as jnp
hits = []
jax.monitoring.register_event_listener(lambda event, **_: hits.append(event))
jax.jit(lambda x: jnp.linalg.inv(x @ x.T))(jnp.eye(5)).block_until_ready()
print(hits.count("/jax/compilation_cache/cache_hits"), hits.count("/jax/compilation_cache/cache_misses"))
"""
    environment = os.environ | {"TRYON_JAX_CACHE": str(tmp_path), "JAX_PLATFORMS": "cpu"}
    told = []
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        told.append([int(count) for count in done.stdout.split()])
    assert told[0][1] > 0
    assert told[1][0] > 0
    assert told[1][1] == 0
