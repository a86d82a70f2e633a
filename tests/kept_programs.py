"""Compiled programs that processes which tests start share with the tests and with each other."""

import os


def kept_programs() -> dict[str, str]:
    """Variables of the environment with which JAX keeps each program in the folder of the tests (see conftest.py)."""
    return {
        "JAX_COMPILATION_CACHE_DIR": os.environ["TRYON_TEST_PROGRAMS"],
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
