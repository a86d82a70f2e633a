"""Settings of every test: strict shapes, strict broadcasting, reproducible properties."""

import atexit
import gc
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import jax
import jaxtyping
import pytest
from jaxtyping import install_import_hook

# Tests neither read nor fill the compiled programs of whoever runs them.
os.environ.pop("TRYON_JAX_CACHE", None)

# Before anything of the library is imported: every jaxtyping annotation in it becomes a runtime check.
install_import_hook("tryon_jax", "runtime_types.check")

from tryon_jax.files.compile_cache import keep_in  # noqa: E402

jax.config.update("jax_numpy_rank_promotion", "raise")

# Most of the time of the tests is compilation. What one test compiles, later tests and the other processes of the same
# run find in a folder: that of TRYON_TEST_PROGRAMS, or one that goes away with the process that made it.
if "TRYON_TEST_PROGRAMS" not in os.environ:
    os.environ["TRYON_TEST_PROGRAMS"] = tempfile.mkdtemp(prefix="tryon_test_programs_")
    atexit.register(shutil.rmtree, os.environ["TRYON_TEST_PROGRAMS"], ignore_errors=True)
keep_in(Path(os.environ["TRYON_TEST_PROGRAMS"]))
# Short compilations are many.
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)

# The same examples in every run; the first call of a property may compile, so it has no deadline.
hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=30, database=None)
hypothesis.settings.load_profile("repeatable")


@pytest.fixture
def x64() -> Iterator[None]:
    """Float64 for the duration of one test."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def unchecked() -> Iterator[None]:
    """No shape checks: stacked pytrees have a leading axis, optimisers put scalars where weights belong."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


# Each compiled program takes a few memory mappings, and Linux allows a process 65,530 of them: past that, LLVM crashes.
MANY_MAPPINGS = 20_000


@pytest.fixture(scope="module", autouse=True)
def few_mappings() -> Iterator[None]:
    """Lets go of compiled programs between modules, before the process runs out of memory mappings."""
    yield
    if sys.platform != "linux":
        return
    with open("/proc/self/maps") as mappings:
        count = sum(1 for _ in mappings)
    if count > MANY_MAPPINGS:
        jax.clear_caches()
        gc.collect()
