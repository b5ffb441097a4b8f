"""Files that are there whole or not at all."""

import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from datagen.errors import DatagenError
from datagen.storage.processes import is_running

_PARTIAL = re.compile(r"\..+\.(?P<process>\d+)-\d+\.partial")


def write_whole(path: Path, data: bytes) -> None:
    """Write a file such that whoever looks sees all of it or what was there before, even after a crash.

    Raises:
        DatagenError: it cannot be written, for example because the disk is full.
    """
    try:
        with replacing(path) as partial, partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise DatagenError(
            f"Cannot write {path}: {error.strerror}. Finished rows are intact; mend this and run the same command."
        ) from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Another path to write a file to, which takes the place of `path` if all went well."""
    partial = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        os.replace(partial, path)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def remove_abandoned(folder: Path) -> None:
    """Delete what processes that were killed left half-written in a folder and the folders in it."""
    for path in folder.rglob(".*.partial"):
        match = _PARTIAL.fullmatch(path.name)
        if match and not is_running(int(match["process"])):
            path.unlink(missing_ok=True)
