"""Files that are there whole or not at all."""

import os
from contextlib import suppress
from pathlib import Path

from obpose.errors import DatagenError


def write_whole(path: Path, data: bytes) -> None:
    """Write a file such that whoever looks sees all of it or what was there before, even after a crash.

    Raises:
        DatagenError: it cannot be written, for example because the disk is full.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        raise DatagenError(
            f"Cannot write {path}: {error.strerror}. The file that was there is intact; mend this and run the same "
            "command again."
        ) from None
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def remove_abandoned(folder: Path) -> None:
    """Delete what a process that was killed left half-written; only for folders that one process writes to."""
    for path in folder.glob(".*.partial"):
        path.unlink(missing_ok=True)
