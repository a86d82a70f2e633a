"""Files that are either complete or not there: written beside the target, then moved over it in one step.

Several files that belong together are written inside `together()`: none of them appears before all are complete.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

_waiting: ContextVar[list[tuple[Path, Path]] | None] = ContextVar("waiting", default=None)


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path in the target's directory that becomes `path` when the block ends without an error.

    The temporary file keeps the target's suffix (savers choose a format by it) and is removed when the block raises.
    Missing parent directories are made. What a symbolic link points to is replaced, not the link.

    Raises:
        IsADirectoryError: `path` is a directory.
        OSError: nothing can be written there, or the disk is full; the message names `path`.
    """
    target = check_target(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        # A short name of its own: the target's may be as long as the file system allows.
        handle, name = tempfile.mkstemp(prefix=".writing-", suffix=target.suffix, dir=target.parent)
    except OSError as error:
        raise _named(error, target) from error
    os.close(handle)
    temporary = Path(name)
    try:
        # mkstemp makes private files; the result gets the permissions that a plain open() would give.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        yield temporary
        waiting = _waiting.get()
        if waiting is None:
            os.replace(temporary, target)
        else:
            waiting.append((temporary, target))
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise _named(error, target) from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def together() -> Iterator[None]:
    """Hold back the files of the block until all are complete; where it raises, none of them is changed.

    What is written in the block can be read under its own name only after the block.
    """
    waiting: list[tuple[Path, Path]] = []
    token = _waiting.set(waiting)
    try:
        yield
        for temporary, target in waiting:
            os.replace(temporary, target)
    finally:
        _waiting.reset(token)
        for temporary, _ in waiting:
            temporary.unlink(missing_ok=True)


def check_target(path: str | Path) -> Path:
    """The file that writing to `path` would make, symbolic links followed; for refusing before work is done.

    Raises:
        IsADirectoryError: it is a directory.
        NotADirectoryError: something on the way to it is a file.
        OSError: its folder cannot be written to, or its name is too long.
    """
    try:
        target = Path(os.path.realpath(Path(path).expanduser()))
        # Finds names that are too long; files that are not there yet are what is wanted.
        with suppress(FileNotFoundError, NotADirectoryError):
            os.stat(target)
    except OSError as error:
        raise _named(error, Path(path)) from error
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {str(target)!r}: it is a directory, a file name is needed")
    folder = target.parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        raise NotADirectoryError(f"cannot write {str(target)!r}: {str(folder)!r} is a file and no folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"cannot write {str(target)!r}: the folder {str(folder)!r} cannot be written to")
    return target


def _named(error: OSError, target: Path) -> OSError:
    """The error, with the name of the target in place of the temporary file's."""
    if str(error).startswith("cannot write"):
        return error
    return type(error)(f"cannot write {str(target)!r}: {error.strerror or error}")


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path` in one step; raises as `atomic_path` does."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path` as UTF-8 in one step; raises as `atomic_path` does."""
    write_bytes(path, text.encode())
