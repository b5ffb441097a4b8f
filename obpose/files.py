"""Files that are there whole or not at all."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from obpose.errors import DatagenError, UsageError


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


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """A folder that one process at a time writes to, and what killed ones left half-written is gone.

    Raises:
        UsageError: another process has it, or it is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file; expected a folder, or a place for a new one.")
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        _lock(descriptor, folder)
        remove_abandoned(folder)
        yield
    finally:
        os.close(descriptor)


def remove_abandoned(folder: Path) -> None:
    """Delete what a process that was killed left half-written; only for folders that one process writes to."""
    for path in folder.glob(".*.partial"):
        path.unlink(missing_ok=True)


def _lock(descriptor: int, folder: Path) -> None:
    """The system lets go of it when the process ends, however it ends."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UsageError(f"Another process is writing to {folder}; let it end, or give another --out.") from None
    except OSError:
        pass  # some file systems of networks have no locks
