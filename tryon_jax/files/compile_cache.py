"""Compiled programs kept from one run of the command line to the next, where the user asks for it.

JAX compiles for the sizes of a garment and the processor at hand, which takes longer than a drape. `TRYON_JAX_CACHE`
names a folder for compiled code. It is not on by itself: on many processors XLA prints an error for each program that
it loads, though none is wrong (jax-ml/jax issue 38445), and nothing that we can set silences it. Only the command line
reads the variable: a library must not change settings of its user's process.
"""

import contextlib
import hashlib
import os
import platform
from pathlib import Path

VARIABLE = "TRYON_JAX_CACHE"
MOST_BYTES = 300_000_000
"""Size to which the folder is cut at the start of a run, oldest programs first."""
LEAST_SECONDS = 0.2
"""Programs that compile faster are not worth a file."""


def cache_folder() -> Path | None:
    """Folder for compiled programs, or None where they are not to be kept.

    It carries the processor's name and features: a home folder may be shared by unlike machines, and code for one of
    them may not run on another.
    """
    choice = os.environ.get(VARIABLE, "")
    if not choice or os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return None
    root = Path(choice).expanduser()
    return root / hashlib.sha256(_processor().encode()).hexdigest()[:12]


def keep_compiled_programs() -> Path | None:
    """Tell JAX to keep what it compiles; before the first compilation.

    Returns:
        The folder; None where nothing is kept, because it is not wanted or the folder cannot be written.
    """
    folder = cache_folder()
    if folder is None:
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        prune(folder)
    except OSError:
        return None
    keep_in(folder)
    return folder


def keep_in(folder: Path) -> None:
    """Let JAX keep what it compiles in a folder that is there, and find it there again."""
    # Imported here: the command line decides about the cache before it loads JAX.
    import jax

    jax.config.update("jax_compilation_cache_dir", str(folder.resolve()))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def prune(folder: Path, most: int = MOST_BYTES) -> int:
    """Delete the oldest files of a folder until those that remain have at most `most` bytes together.

    Returns:
        The number of files deleted.
    """
    found = []
    for path in folder.iterdir():
        # Another process may delete a file at the same moment.
        with contextlib.suppress(OSError):
            found.append((path.stat().st_mtime, path.stat().st_size, path))
    total = sum(size for _, size, _ in found)
    deleted = 0
    for _, size, path in sorted(found, key=lambda entry: entry[0]):
        if total <= most:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            deleted += 1
        total -= size
    return deleted


def _processor() -> str:
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
        about = [line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))]
        return "".join(sorted(set(about)))
    return platform.processor() + platform.machine()
