"""Files that are there whole or not at all."""

import glob
import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from datagen.storage.locks import FolderLock
from datagen.storage.processes import is_running
from datagen.storage.spec import SPEC_FILE
from obpose.errors import Busy, DatagenError, UsageError


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
        ) from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Another folder to write files to, which comes to be `folder` if all went well; else nothing is left of it.

    Raises:
        UsageError: there is something already, perhaps since a moment ago; nothing was changed.
        DatagenError: it cannot be written.
    """
    check_free(folder)
    folder = folder.resolve()
    partial = _unfinished(folder)
    try:
        partial.mkdir(parents=True)
        yield partial
        check_free(folder)
        # Fails where somebody was faster: a folder takes the place of an empty one only.
        partial.rename(folder)
    except (OSError, DatagenError) as error:
        reason = _reason(error)
        check_free(folder)
        raise DatagenError(f"Cannot write {folder}: {reason}; mend this, or give another --out.") from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _reason(error: OSError | DatagenError) -> str:
    """Give the system's reason for a failed write, also if `write_whole` wrapped it; raise any other error."""
    cause = error if isinstance(error, OSError) else error.__cause__
    if not isinstance(cause, OSError):
        raise error
    return cause.strerror or str(cause)


def _unfinished(path: Path) -> Path:
    """Temporary path at which this thread writes `path`; deletes leftovers of killed processes."""
    partial = path.with_name(f".{path.stem}.{os.getpid()}-{threading.get_ident()}.unfinished{path.suffix}")
    for left in path.parent.glob(f".{glob.escape(path.stem)}.*-*.unfinished{glob.escape(path.suffix)}"):
        process = left.name.removeprefix(f".{path.stem}.").partition("-")[0]
        if left == partial or (process.isdecimal() and not is_running(int(process))):
            delete = shutil.rmtree if left.is_dir() else os.unlink
            with suppress(OSError):
                delete(left)
    return partial


def check_free(folder: Path) -> None:
    """Check that a folder does not exist or is empty.

    Raises:
        UsageError: it is not empty, is the current folder, holds a dataset, or is no folder.
    """
    try:
        resolved = folder.resolve()
    except (OSError, RuntimeError):
        # Circular links raise either error, depending on the Python version.
        raise UsageError(f"{folder} is a link that leads to itself; give another --out.") from None
    if resolved == Path.cwd():
        raise UsageError(f"{folder} is the current folder; give a new one with --out, nothing was changed.")
    check_no_dataset(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} is there already and not empty; give another --out, nothing was changed.")


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Another path, with the same ending, to write a file to, which comes to be `path` if all went well.

    Raises:
        UsageError: there is something already, perhaps since a moment ago; nothing was changed.
        DatagenError: it cannot be written.
    """
    check_new(path)
    partial = _unfinished(path)
    try:
        # Told now, and not when all that is to be written has been made.
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.touch()
        yield partial
        _rename_new(partial, path)
    except (OSError, DatagenError) as error:
        raise DatagenError(f"Cannot write {path}: {_reason(error)}; mend this, or give another --out.") from None
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def _rename_new(partial: Path, path: Path) -> None:
    try:
        # Fails where somebody was faster, as a rename would not.
        os.link(partial, path)
    except FileExistsError:
        raise _taken(path) from None
    except OSError:
        # Some file systems have no second names of a file.
        check_new(path)
        partial.rename(path)


def check_new(path: Path) -> None:
    """Check that nothing is where a file is to be.

    Raises:
        UsageError: something is.
    """
    if os.path.lexists(path):
        raise _taken(path)


def _taken(path: Path) -> UsageError:
    link = " as a link that leads nowhere" if path.is_symlink() and not os.path.exists(path) else ""
    return UsageError(f"{path} is there already{link}; give another --out, nothing was changed.")


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Hold a folder for results alone while writing to it; files that killed processes left half-written are removed.

    Raises:
        Busy: another process has it.
        UsageError: it is a file, or the folder of a dataset.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file; expected a folder, or a place for a new one.")
    check_no_dataset(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with FolderLock(folder) as lock:
        if not lock.take_alone():
            raise Busy(f"Another process is writing to {folder}; let it end, or give another --out.")
        remove_abandoned(folder)
        yield


def check_no_dataset(folder: Path) -> None:
    """Check that a folder for results is not the folder of a dataset.

    Raises:
        UsageError: it is.
    """
    if os.path.lexists(folder / SPEC_FILE):
        raise UsageError(f"{folder} holds a dataset; give another --out, nothing was changed.")


def remove_abandoned(folder: Path) -> None:
    """Delete what a process that was killed left half-written; only for folders that one process writes to."""
    for path in folder.glob(".*.partial"):
        # Named as `write_whole` does; what is called otherwise is somebody else's.
        if path.suffixes[-2:-1] and path.suffixes[-2][1:].isdecimal():
            path.unlink(missing_ok=True)
