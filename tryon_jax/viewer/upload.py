"""Garment meshes that visitors hand in: refused by size before they are kept, and read as untrusted files."""

import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import viser

from tryon_jax.checks import check_choice
from tryon_jax.mesh.loaded_garment import LoadedGarment
from tryon_jax.mesh.reading import FORMATS, load_garment, read_triangles
from tryon_jax.viewer.page_model import UploadedMesh
from tryon_jax.wear.own import OwnGarment

MAX_BYTES = 20_000_000
"""Largest file that is taken; a garment of 100,000 vertices as an OBJ file is about half of it."""
MAX_VERTICES = 60_000
"""Largest mesh that is taken, so that one visitor does not occupy the computer for minutes."""
_ALLOWED = tuple(suffix for suffix in FORMATS if suffix != ".gltf")


def check_size(name: str, size: int) -> None:
    """Raise `ValueError` for a file that is too large."""
    if size > MAX_BYTES:
        raise ValueError(f"{name!r} has {size / 1e6:.1f} MB, but at most {MAX_BYTES / 1e6:g} MB are taken")


def read_upload(
    name: str,
    content: bytes,
    bring: Callable[[Path, str], LoadedGarment | OwnGarment] = lambda path, _: load_garment(path),
) -> UploadedMesh:
    """The garment in an uploaded file.

    Args:
        name: The file's.
        content: Its bytes.
        bring: Reads the file at a path under a name; `Session.bring` also puts it on the body and settles it there.

    Raises:
        ValueError: too large a file or mesh, another format, or no garment (see `bring`).
    """
    shown = Path(name.replace("\\", "/")).name
    check_size(shown, len(content))
    # A .gltf refers to other files, which an upload has not.
    suffix = check_choice("format of an uploaded mesh", Path(shown).suffix.lower(), _ALLOWED)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"upload{suffix}"
        path.write_bytes(content)
        try:
            count = len(read_triangles(path)[0])
            if count > MAX_VERTICES:
                raise ValueError(f"{shown!r} has {count} vertices, but at most {MAX_VERTICES} are taken")
            loaded = bring(path, shown)
        except ValueError as error:
            raise ValueError(str(error).replace(str(path), shown)) from error
    return UploadedMesh(shown, loaded)


def refuse_large_uploads(client: viser.ClientHandle, refused: Callable[[Exception], None]) -> None:
    """Drop a transfer that announces too large a file before any of it is kept.

    viser keeps an upload of any size in memory until it is complete, and has no public place to say no. Where a version
    of it has not what is used here, `read_upload` still refuses the file afterwards.
    """
    with suppress(AttributeError, ImportError):
        from viser._messages import FileTransferPartAck, FileTransferStartUpload

        socket, kept = client.gui._websock_interface, client.gui._current_file_upload_states

        def announced(_: Any, message: FileTransferStartUpload) -> None:
            try:
                check_size(message.filename, message.size_bytes)
            except ValueError as error:
                kept.pop(message.transfer_uuid, None)
                # The page waits for the end of the transfer.
                source, size = message.source_component_uuid, message.size_bytes
                socket.queue_message(FileTransferPartAck(source, message.transfer_uuid, size, size))
                refused(error)

        # Called after viser's own handler, which has made room for the file by then.
        socket.register_handler(FileTransferStartUpload, announced)
