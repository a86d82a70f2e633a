"""Files that are either complete or not there: written beside the target, then moved over it in one step."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path in the target's directory that becomes `path` when the block ends without an error.

    The temporary file keeps the target's suffix (savers choose a format by it) and is removed when the block raises.
    Missing parent directories are made.

    Raises:
        IsADirectoryError: `path` is a directory.
        OSError: nothing can be written there.
    """
    target = Path(path).expanduser()
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {str(target)!r}: it is a directory, a file name is needed")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
    except OSError as error:
        raise type(error)(f"cannot write {str(target)!r}: {error.strerror}") from error
    os.close(handle)
    temporary = Path(name)
    try:
        # mkstemp makes private files; the result gets the permissions that a plain open() would give.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        yield temporary
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path` in one step; raises as `atomic_path` does."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path` as UTF-8 in one step; raises as `atomic_path` does."""
    write_bytes(path, text.encode())
