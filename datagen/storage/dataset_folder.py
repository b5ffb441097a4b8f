"""A dataset's folder: which files are ours, how they are written whole or not at all, and who may write."""

import os
import re
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from datagen.config import recipe_to_dict
from datagen.errors import Busy, CorruptFile, DatagenError, UsageError
from datagen.schema import GENERATOR, SPLITS
from datagen.storage.locks import FolderLock
from datagen.storage.processes import is_running
from datagen.storage.shard import scenes_present, shard_settings
from datagen.storage.spec import (
    CARD_FILE,
    MANIFEST_FILE,
    SPEC_FILE,
    Spec,
    differences,
    read_spec,
    recipe_of,
    settings_hash,
    shard_ranges,
    spec_text,
    with_splits,
)

_OURS = re.compile(
    rf"({SPEC_FILE}|{MANIFEST_FILE}|{CARD_FILE}|preview\.\w+|({'|'.join(SPLITS)})-\d{{5,}}\.h5)(\.partial-.+)?"
)
_PARTIAL = re.compile(r".+\.partial-(?P<host>.+)-(?P<process>\d+)")
_ABANDONED_SECONDS = 3600
_WAIT_SECONDS = 0.05
_PATIENCE_SECONDS = 600
"""How long to wait for another process to prepare the folder."""


@contextmanager
def filling(
    folder: Path, wanted: Spec, *, overwrite: bool = False, prove: Callable[[], object] = lambda: None
) -> Iterator[Spec]:
    """Hold a dataset's folder while scenes are written to it, and give the dataset's spec.

    Processes that make the same dataset hold its folder together. To begin a dataset, to give one up or to rebuild its
    `dataset.json`, a process waits until it has the folder alone. A dataset of the same settings goes on, even where
    `overwrite` is set, so that the same command can be repeated. A run that fails before its first shard leaves nothing
    new behind.

    Args:
        folder: Where the dataset is or will be.
        wanted: Its spec.
        overwrite: Give up a dataset of other settings; scenes of the wanted ones stay.
        prove: Called before a dataset is begun; where it raises, what the folder holds stays as it is.

    Yields:
        The spec that holds from now on: as `wanted`, but with no fewer scenes than were asked for before or are there.

    Raises:
        Busy: another process writes a dataset of other settings to the folder.
        UsageError: the folder holds something else, or a dataset of other settings that `overwrite` does not give up.
        CorruptFile: a file that is there cannot be read.
        OSError: the folder cannot be made or written to.
    """
    begun = _Begun(settings_hash(wanted))
    try:
        lock, spec = _occupy(folder, wanted, begun, overwrite, prove)
        with lock:
            yield spec
    except BaseException:
        _remove_begun(folder, begun)
        raise


@dataclass(eq=False)
class _Begun:
    """Folders and spec that this process has created; it removes them if it fails before the first shard."""

    settings: str
    """Settings hash of the dataset."""
    folders: list[Path] = field(default_factory=list)
    """Created folders, from the outermost one to the dataset's own."""
    spec: bool = False
    """Whether the process has begun to write the spec of a new dataset."""


def _occupy(
    folder: Path, wanted: Spec, begun: _Begun, overwrite: bool, prove: Callable[[], object]
) -> tuple[FolderLock, Spec]:
    """Wait for the folder, and take it with the other processes that make the same dataset."""
    give_up = time.monotonic() + _PATIENCE_SECONDS
    while time.monotonic() < give_up:
        _make(folder, begun)
        with ExitStack() as stack:
            lock = None
            with suppress(FileNotFoundError):  # another process has failed and removed it
                lock = stack.enter_context(FolderLock(folder))
            if lock and (spec := _enter(lock, wanted, begun, overwrite, prove)):
                stack.pop_all()
                return lock, spec
        time.sleep(_WAIT_SECONDS)
    raise Busy(f"Another process has been preparing {folder} for a long time; stop it, or give another --out.")


def _enter(lock: FolderLock, wanted: Spec, begun: _Begun, overwrite: bool, prove: Callable[[], object]) -> Spec | None:
    """The spec that holds, with the folder's shared lock; None where another process is preparing the folder."""
    folder = lock.folder
    if lock.take_alone():
        if not lock.is_current():
            return None
        spec = _prepare(folder, wanted, begun, overwrite, prove)
        # The system may grant the folder to another process before this one shares it.
        return spec if lock.take_shared() and _settings(folder) == settings_hash(spec) else None
    if not (lock.take_shared() and lock.is_current() and (folder / SPEC_FILE).exists()):
        return None
    if changed := _changes(read_spec(folder), wanted):
        raise Busy(
            f"Another {GENERATOR} is writing to {folder} with other settings ({'; '.join(changed)}). "
            "Wait for it, or give another folder with --out."
        )
    _remove_abandoned(folder)
    return settle(folder, wanted)


def _prepare(folder: Path, wanted: Spec, begun: _Begun, overwrite: bool, prove: Callable[[], object]) -> Spec:
    """Continue, rebuild or begin a dataset in a folder that this process has alone."""
    _remove_abandoned(folder)
    if spec := _continued(folder, wanted, overwrite):
        return spec
    prove()
    # Where there are no locks, another process may have begun the same dataset meanwhile.
    if spec := _continued(folder, wanted, overwrite):
        return spec
    _give_up(folder, settings_hash(wanted))
    begun.spec = True
    write_whole(folder / SPEC_FILE, spec_text(wanted).encode())
    return wanted


def _continued(folder: Path, wanted: Spec, overwrite: bool) -> Spec | None:
    """The spec of the dataset that is there, or is rebuilt from its shards; None where one is to be begun."""
    if (folder / SPEC_FILE).exists():
        return settle(folder, wanted) if _goes_on(folder, wanted, overwrite) else None
    _check_free(folder)
    if not _shards(folder) or (overwrite and _is_of_others(folder, wanted)):
        return None
    return _rebuild(folder, wanted)


def _rebuild(folder: Path, wanted: Spec) -> Spec:
    """Write a spec that was lost anew, from shards that all are of the wanted settings and in their places."""
    try:
        present = {split: scenes_present(folder, wanted, split) for split in SPLITS}
    except DatagenError as error:
        raise UsageError(f"{folder} has no {SPEC_FILE}, and it cannot be rebuilt for this command: {error}") from None
    spec = with_splits(wanted, _most(wanted["splits"], present))
    write_whole(folder / SPEC_FILE, spec_text(spec).encode())
    return spec


def settle(folder: Path, wanted: Spec) -> Spec:
    """Let the folder's spec have as many scenes as it has, as are wanted and as are there, whichever is most.

    Raises:
        UsageError: the folder holds a dataset of other settings, or a shard that belongs elsewhere.
        CorruptFile: a file that is there cannot be read.
    """
    old = read_spec(folder)
    if changed := _changes(old, wanted):
        raise UsageError(
            f"{folder} holds a dataset of other settings ({'; '.join(changed)}). "
            "Give another folder with --out, the same settings, or --overwrite to make it anew."
        )
    grown = with_splits(old, _most(old["splits"], wanted["splits"]))
    ends = {split: len(shard_ranges(old["splits"][split], old["scenes_per_shard"])) for split in SPLITS}
    present = {split: scenes_present(folder, grown, split, first=ends[split] - 1) for split in SPLITS}
    spec = with_splits(grown, _most(grown["splits"], present))
    if spec != old:
        write_file(folder, SPEC_FILE, spec_text(spec).encode(), settings_hash(old))
    return spec


def _most(first: Mapping[str, int], second: Mapping[str, int]) -> dict[str, int]:
    return {split: max(first[split], second[split]) for split in SPLITS}


def write_file(folder: Path, name: str, data: bytes, settings: str) -> None:
    """Write a file of a dataset as `write_whole`, unless another dataset has taken its folder.

    Args:
        folder: The dataset's folder.
        name: Name of the file.
        data: Its content.
        settings: Settings hash of the dataset that the file belongs to.

    Raises:
        DatagenError: `dataset.json` is gone, or is of other settings; nothing was written.
    """

    def check_settings() -> None:
        if _settings(folder) != settings:
            raise DatagenError(
                f"{folder / SPEC_FILE} is gone or belongs to another dataset by now; {name} was not written. "
                "Run the command again, perhaps with another --out."
            )

    write_whole(folder / name, data, check=check_settings)


def write_whole(path: Path, data: bytes, *, check: Callable[[], object] = lambda: None) -> None:
    """Write a file such that whoever looks sees all of it or nothing, even after a crash.

    Args:
        path: The file.
        data: Its content.
        check: Called before the file takes its name; where it raises, what was there before stays.

    Raises:
        DatagenError: it cannot be written, for example because the disk is full; what was there before is intact.
    """
    partial = path.with_name(f"{path.name}.partial-{socket.gethostname()}-{os.getpid()}")
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        check()
        os.replace(partial, path)
        _sync_folder(path.parent)
    except OSError as error:
        raise DatagenError(
            f"Cannot write {path}: {error.strerror}. Finished files are intact; mend this and run the same command."
        ) from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def _settings(folder: Path) -> str | None:
    """Settings hash of the folder's spec, None where there is none that can be read."""
    try:
        return settings_hash(read_spec(folder))
    except (DatagenError, OSError):
        return None


def _make(folder: Path, begun: _Begun) -> None:
    """Make a folder and its parents, and note which ones are new."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in reversed(missing):
        try:
            path.mkdir()
        except (FileExistsError, NotADirectoryError):
            continue
        except FileNotFoundError:
            if path.parent.is_dir():
                raise
            break  # another process has failed and removed the parent
        begun.folders.append(path)
    if any(path.exists() and not path.is_dir() for path in (folder, *folder.parents)) or _leads_nowhere(folder):
        raise UsageError(f"{folder} cannot be a folder: there is a file in its place; give another --out.")


def _leads_nowhere(path: Path) -> bool:
    return path.is_symlink() and not path.exists()


def _remove_begun(folder: Path, begun: _Begun) -> None:
    """Remove what a failed run has begun, unless there are scenes, or another process is at work there."""
    with suppress(OSError), FolderLock(folder) as lock:
        if lock.take_alone() and lock.is_real and lock.is_current():
            if begun.spec and os.listdir(folder) == [SPEC_FILE] and _settings(folder) == begun.settings:
                (folder / SPEC_FILE).unlink()
            if folder in begun.folders:
                folder.rmdir()
    for path in reversed(begun.folders):
        if path != folder:
            with suppress(OSError):  # it is not empty
                path.rmdir()


def _check_free(folder: Path) -> None:
    """Check that a folder without a spec holds nothing that is not ours."""
    foreign = sorted(path.name for path in folder.iterdir() if path not in set(_partials(folder)))
    if foreign and not any(shard_settings(path) for path in _shards(folder)):
        raise UsageError(
            f"{folder} holds no dataset but {len(foreign)} other files ({', '.join(foreign[:3])}); "
            "give an empty or new folder with --out."
        )


def _is_of_others(folder: Path, wanted: Spec) -> bool:
    return any(shard_settings(path) != settings_hash(wanted) for path in _shards(folder))


def _goes_on(folder: Path, wanted: Spec, overwrite: bool) -> bool:
    """Whether the folder's dataset is the wanted one, or one that stands in its way; else a new one is begun."""
    try:
        changed = bool(_changes(read_spec(folder), wanted))
    except CorruptFile:
        if not overwrite:
            raise
        _check_ours(folder)
        changed = True
    # A spec alone is what a run leaves behind that was killed before its first shard.
    return not changed or not (overwrite or _is_bare(folder))


def _changes(old: Spec, wanted: Spec) -> list[str]:
    return differences(_normal(old), _normal(wanted))


def _normal(spec: Spec) -> Spec:
    """With every constant that came to recipes after this spec was written, at its default."""
    return {**spec, "recipe": recipe_to_dict(recipe_of(spec))}


def _is_bare(folder: Path) -> bool:
    """Whether nothing of ours is there but the spec, and nobody is about to write anything."""
    return [path.name for path in _own_files(folder)] == [SPEC_FILE]


def _check_ours(folder: Path) -> None:
    """Refuse to give up files that no shard proves to be ours."""
    if not any(shard_settings(path) for path in _shards(folder)):
        raise UsageError(
            f"{folder / SPEC_FILE} cannot be read, and there is no shard beside it that tells whose it is; "
            "delete it yourself, or give an empty or new folder with --out."
        )


def _give_up(folder: Path, settings: str) -> None:
    """Delete our files, except for the spec, which someone may be writing right now, and shards of these settings."""
    kept = {path for path in _shards(folder) if shard_settings(path) == settings}
    for path in _own_files(folder):
        if path not in kept and not path.name.startswith(SPEC_FILE):
            path.unlink(missing_ok=True)


def _shards(folder: Path) -> list[Path]:
    return [path for path in _own_files(folder) if path.suffix == ".h5"]


def _own_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if _OURS.fullmatch(path.name))


def _partials(folder: Path) -> Iterator[Path]:
    return (path for path in _own_files(folder) if _PARTIAL.fullmatch(path.name))


def _remove_abandoned(folder: Path) -> None:
    for path in _partials(folder):
        with suppress(FileNotFoundError):
            if _is_abandoned(path):
                path.unlink()


def _is_abandoned(partial: Path) -> bool:
    """Whether its writer is gone; of a writer on another machine we only know how long it has been silent."""
    match = _PARTIAL.fullmatch(partial.name)
    assert match
    if match["host"] != socket.gethostname():
        return time.time() - partial.stat().st_mtime > _ABANDONED_SECONDS
    process = int(match["process"])
    return process == os.getpid() or not is_running(process)


def _sync_folder(folder: Path) -> None:
    """Make the new name last; file systems that cannot do it keep it as safe as they can."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)
