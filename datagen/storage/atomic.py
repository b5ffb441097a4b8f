"""Atomic files and folders of all packages: each is complete or missing, even after a crash.

A file is written under a temporary name beside its place, and renamed. The temporary name holds the writer's host,
process and thread, so that files of killed writers can be found and deleted.
"""

import os
import re
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from datagen.errors import Busy, DatagenError, UsageError
from datagen.storage.locks import FolderLock
from datagen.storage.spec import SPEC_FILE

CACHE = "OBPOSE_CACHE"
"""Environment variable that names the cache folder; the default is `$XDG_CACHE_HOME/obpose` or `~/.cache/obpose`."""

_TEMPORARY = re.compile(r"\.(?P<target>.+)\.partial-(?P<host>.+)-(?P<process>\d+)-(?P<thread>\d+)")
_ABANDONED_SECONDS = 3600
"""Age from which a temporary file of another host counts as abandoned."""


def write_atomically(path: Path, data: bytes | Iterable[bytes], *, check: Callable[[], object] = lambda: None) -> None:
    """Write a file atomically and durably; create its folder if necessary.

    Args:
        path: The file.
        data: Its content, whole or in parts.
        check: Called just before the file takes its name; if it raises, the previous file stays.

    Raises:
        DatagenError: the file cannot be written, for example because the disk is full; the previous one is intact.
    """
    try:
        with replacing(path) as temporary:
            with temporary.open("wb") as file:
                file.writelines([data] if isinstance(data, bytes) else data)
                file.flush()
                os.fsync(file.fileno())
            check()
        _sync_folder(path.parent)
    except OSError as error:
        raise DatagenError(
            f"Cannot write {path}: {_reason(error)}. Finished files are intact; fix this and run the same command."
        ) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path for a file that replaces `path` if the block succeeds; create its folder if necessary."""
    temporary = temporary_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextmanager
def new_folder(folder: Path, *, replace: bool = False) -> Iterator[Path]:
    """Yield a temporary folder that becomes `folder` if the block succeeds, and is deleted if not.

    With `replace`, a present folder is deleted once the block has succeeded; callers check that it may be.

    Raises:
        UsageError: the folder already exists and is not empty, was created meanwhile, or is a link that leads to
            itself; nothing was changed.
        DatagenError: it cannot be written.
    """
    check = check_no_dataset if replace else check_new_folder
    check(folder)
    if replace:
        _finish_exchange(resolve_output(folder))
    with _temporary_folder(folder, folder.resolve()) as temporary:
        yield temporary
        check(folder)
        if replace and folder.exists():
            _exchange(folder.resolve(), temporary)
            return
        # A folder can only replace an empty one: the rename fails if another process was faster.
        try:
            temporary.rename(folder.resolve())
        except OSError:
            check_new_folder(folder)
            raise


@contextmanager
def updated_folder(folder: Path, names: Sequence[str]) -> Iterator[Path]:
    """Yield a copy of the files with these names in `folder`, which replaces them if the block succeeds.

    Files are replaced one by one in the order of `names`; a missing folder appears as a whole.

    Raises:
        DatagenError: it cannot be written.
    """
    with _temporary_folder(folder, folder.resolve()) as temporary:
        for name in names:
            if (folder / name).exists():
                shutil.copy2(folder / name, temporary)
        yield temporary
        if not folder.exists():
            temporary.rename(folder.resolve())
            return
        for name in names:
            if (temporary / name).exists():
                os.replace(temporary / name, folder / name)


def _exchange(old: Path, new: Path) -> None:
    """Replace a folder by another and delete it; it comes back if the other cannot take its place."""
    aside = temporary_path(_aside(old))
    old.rename(aside)
    try:
        new.rename(old)
    except BaseException:
        if not old.exists():
            aside.rename(old)
        raise
    try:
        shutil.rmtree(aside, ignore_errors=True)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"Interrupted; {old} is the new folder and complete. Delete the rest of the old one, {aside}."
        ) from None


def _finish_exchange(old: Path) -> None:
    """Delete the folder that a killed writer had moved aside, or put it back if no other took its place."""
    if old.parent.is_dir():
        for left in old.parent.iterdir():
            if target_name(left) == _aside(old).name != left.name and _is_abandoned(left):
                shutil.rmtree(left) if old.exists() else left.rename(old)


def _aside(old: Path) -> Path:
    return old.with_name(f"{old.name}.old")


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path, with the same name in another folder, for a file that becomes `path` on success.

    Raises:
        UsageError: the file already exists, or was created meanwhile; nothing was changed.
        DatagenError: it cannot be written.
    """
    check_new_file(path)
    with _temporary_folder(path, path) as folder:
        yield folder / path.name
        try:
            # Unlike a rename, a link fails if another process was faster.
            os.link(folder / path.name, path)
        except FileExistsError:
            check_new_file(path)
            raise
        except OSError:  # the file system has no hard links
            check_new_file(path)
            (folder / path.name).rename(path)


@contextmanager
def _temporary_folder(named: Path, path: Path) -> Iterator[Path]:
    """Hold a temporary folder beside `path`; errors name the path that the user gave."""
    temporary = temporary_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove(left for left in path.parent.iterdir() if target_name(left) == path.name != left.name)
        temporary.mkdir()
        yield temporary
    except (OSError, DatagenError) as error:
        # `write_atomically` wraps the system's error; other errors of ours pass.
        cause = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(cause, OSError):
            raise
        raise DatagenError(f"Cannot write {named}: {_reason(cause)}; fix this, or give another --out.") from None
    finally:
        if temporary.exists():
            shutil.rmtree(temporary, ignore_errors=True)


def resolve_output(path: Path) -> Path:
    """Resolve the links of a path for results.

    Raises:
        UsageError: it is a link that leads to itself.
    """
    # A circular link raises either error or stays a link, depending on the Python version.
    with suppress(OSError, RuntimeError):
        if not (resolved := path.resolve()).is_symlink():
            return resolved
    raise UsageError(f"{path} is a link that leads to itself; give another --out.")


def check_new_folder(folder: Path) -> None:
    """Check that a folder does not exist or is empty.

    Raises:
        UsageError: it is not empty, is the current folder, holds a dataset, or is not a folder.
    """
    if resolve_output(folder) == Path.cwd():
        raise UsageError(f"{folder} is the current folder; give a new one with --out, nothing was changed.")
    check_no_dataset(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} already exists and is not empty; give another --out, nothing was changed.")


def check_new_file(path: Path) -> None:
    """Check that a file does not exist.

    Raises:
        UsageError: it exists, or is a broken link.
    """
    if os.path.lexists(path):
        link = "" if os.path.exists(path) else " as a link that leads nowhere"
        raise UsageError(f"{path} already exists{link}; give another --out, nothing was changed.")


def check_no_dataset(folder: Path) -> None:
    """Check that a folder for results does not hold a dataset.

    Raises:
        UsageError: it does.
    """
    if os.path.lexists(folder / SPEC_FILE):
        raise UsageError(f"{folder} holds a dataset; give another --out, nothing was changed.")


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Lock a folder for results while writing to it; temporary files of killed processes are removed first.

    Raises:
        Busy: another process holds the lock.
        UsageError: the folder is a file, or holds a dataset.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file; expected a folder, or a place for a new one.")
    check_no_dataset(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with closing(FolderLock(folder)) as lock:
        if not lock.take_alone():
            raise Busy(f"Another process is writing to {folder}; wait for it, or give another --out.")
        remove_abandoned(folder)
        yield


def temporary_path(path: Path) -> Path:
    """Give the temporary path at which this thread writes a file."""
    return path.with_name(f".{path.name}.partial-{socket.gethostname()}-{os.getpid()}-{threading.get_native_id()}")


def target_name(path: Path) -> str:
    """Give the name that a temporary file will take; any other file's own name."""
    match = _TEMPORARY.fullmatch(path.name)
    return match["target"] if match else path.name


def remove_abandoned(folder: Path, *, recursive: bool = False) -> None:
    """Delete the temporary files and folders of killed writers in a folder."""
    _remove(folder.rglob(".*.partial-*") if recursive else folder.glob(".*.partial-*"))


def _remove(paths: Iterable[Path]) -> None:
    for path in list(paths):
        with suppress(OSError):
            if _is_abandoned(path):
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _is_abandoned(path: Path) -> bool:
    """Whether the writer of a temporary file is gone; writers on other hosts can only be judged by the file's age."""
    match = _TEMPORARY.fullmatch(path.name)
    if not match:
        return False
    if match["host"] != socket.gethostname():
        return time.time() - path.stat().st_mtime > _ABANDONED_SECONDS
    if int(match["process"]) != os.getpid():
        return not is_running(int(match["process"]))
    others = {thread.native_id for thread in threading.enumerate()} - {threading.get_native_id()}
    return int(match["thread"]) not in others


def cache_folder() -> Path:
    """Folder of everything that can be made again, such as tracks and hulls."""
    if named := os.environ.get(CACHE):
        return Path(named).expanduser()
    # The XDG specification says that relative paths are to be ignored.
    xdg = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (xdg if xdg.is_absolute() else Path.home() / ".cache") / "obpose"


def is_running(process: int) -> bool:
    """Whether a process of this number runs, whoever owns it; one that ended and was not waited for does not."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    # Linux keeps the number of an ended process until its parent waits for it; in containers, often no parent does.
    try:
        state = Path(f"/proc/{process}/stat").read_text(errors="replace").rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state not in "ZX"


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def _sync_folder(folder: Path) -> None:
    """Make a new name durable, on file systems that support it."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)
