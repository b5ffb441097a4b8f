"""A dataset's folder: which files belong to the dataset, which process may write, and how a dataset is started."""

import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from datagen.config import recipe_to_dict
from datagen.errors import Busy, CorruptFile, DatagenError, UsageError
from datagen.schema import GENERATOR, SPLITS
from datagen.storage.atomic import remove_abandoned, target_name, write_atomically
from datagen.storage.locks import FolderLock
from datagen.storage.shard import scenes_present, shard_settings
from datagen.storage.spec import (
    CARD_FILE,
    CROISSANT_FILE,
    MANIFEST_FILE,
    SPEC_FILE,
    Spec,
    compression_of,
    differences,
    read_spec,
    recipe_of,
    settings_hash,
    shard_ranges,
    spec_text,
    with_splits,
)

_FACTS = "|".join((SPEC_FILE, MANIFEST_FILE, CARD_FILE, CROISSANT_FILE))
_OURS = re.compile(rf"({_FACTS}|preview\.\w+|({'|'.join(SPLITS)})-\d{{5,}}\.(h5|json))")
_WAIT_SECONDS = 0.05


@contextmanager
def filling(
    folder: Path,
    wanted: Spec,
    *,
    overwrite: bool = False,
    prove: Callable[[], object] = lambda: None,
    patience_seconds: float = 600,
) -> Iterator[Spec]:
    """Hold a dataset's folder while scenes are written to it, and give the dataset's spec.

    Processes that make the same dataset share its folder. A process needs the folder alone to start a dataset, to
    delete one, or to rebuild its `dataset.json`; it waits for that. A dataset of the same settings is continued, even
    with `overwrite`, so that the same command can be repeated. A run that fails before its first shard leaves nothing
    behind.

    Args:
        folder: Where the dataset is or will be.
        wanted: Its spec.
        overwrite: Delete a dataset of other settings; scenes of the wanted settings stay.
        prove: Called before a dataset is started; if it raises, the folder stays unchanged.
        patience_seconds: Time to wait for another process that prepares the folder.

    Yields:
        The spec from now on: `wanted`, but never with fewer scenes than requested before or present.

    Raises:
        Busy: another process writes a dataset of other settings to the folder.
        UsageError: the folder holds something else, or a dataset of other settings without `overwrite`.
        CorruptFile: a present file cannot be read.
        OSError: the folder cannot be made or written to.
    """
    begun = _Begun(settings_hash(wanted))
    try:
        lock, spec = _occupy(folder, wanted, begun, overwrite, prove, patience_seconds)
        with closing(lock):
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
    folder: Path, wanted: Spec, begun: _Begun, overwrite: bool, prove: Callable[[], object], patience_seconds: float
) -> tuple[FolderLock, Spec]:
    """Wait for the folder, and share it with other processes that make the same dataset."""
    give_up = time.monotonic() + patience_seconds
    while time.monotonic() < give_up:
        _make(folder, begun)
        with ExitStack() as stack:
            lock = None
            with suppress(FileNotFoundError):  # another process has failed and removed it
                lock = stack.enter_context(closing(FolderLock(folder)))
            if lock and (spec := _enter(lock, wanted, begun, overwrite, prove)):
                stack.pop_all()
                return lock, spec
        time.sleep(_WAIT_SECONDS)
    raise Busy(f"Another process has been preparing {folder} for a long time; stop it, or give another --out.")


def _enter(lock: FolderLock, wanted: Spec, begun: _Begun, overwrite: bool, prove: Callable[[], object]) -> Spec | None:
    """Give the current spec under the folder's shared lock; None while another process prepares the folder."""
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
    remove_abandoned(folder)
    return settle(folder, wanted)


def _prepare(folder: Path, wanted: Spec, begun: _Begun, overwrite: bool, prove: Callable[[], object]) -> Spec:
    """Continue, rebuild or start a dataset in a folder that this process holds alone."""
    remove_abandoned(folder)
    if spec := _continued(folder, wanted, overwrite):
        return spec
    prove()
    # On file systems without locks, another process may have started the same dataset by now.
    if spec := _continued(folder, wanted, overwrite):
        return spec
    _give_up(folder, settings_hash(wanted))
    begun.spec = True
    write_atomically(folder / SPEC_FILE, spec_text(wanted).encode())
    return wanted


def _continued(folder: Path, wanted: Spec, overwrite: bool) -> Spec | None:
    """Give the spec of the present dataset, rebuilt from its shards if necessary; None to start a new one."""
    if (folder / SPEC_FILE).exists():
        return settle(folder, wanted) if _goes_on(folder, wanted, overwrite) else None
    _check_free(folder)
    settings = settings_hash(wanted)
    if not _shards(folder) or (overwrite and any(shard_settings(path) != settings for path in _shards(folder))):
        return None
    return _rebuild(folder, wanted)


def _rebuild(folder: Path, wanted: Spec) -> Spec:
    """Rebuild a lost spec from shards that all have the wanted settings and are in their places."""
    try:
        present = {split: scenes_present(folder, wanted, split) for split in SPLITS}
    except DatagenError as error:
        raise UsageError(f"{folder} has no {SPEC_FILE}, and it cannot be rebuilt for this command: {error}") from None
    spec = with_splits(wanted, _most(wanted["splits"], present))
    write_atomically(folder / SPEC_FILE, spec_text(spec).encode())
    return spec


def settle(folder: Path, wanted: Spec) -> Spec:
    """Raise the numbers of scenes in the folder's spec to the wanted and the present ones.

    Raises:
        UsageError: the folder holds a dataset of other settings, or a shard that belongs elsewhere.
        CorruptFile: a present file cannot be read.
    """
    old = read_spec(folder)
    if changed := _changes(old, wanted):
        raise UsageError(
            f"{folder} holds a dataset of other settings ({'; '.join(changed)}). "
            "Give another folder with --out, the same settings, or --overwrite to replace it."
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
    """Write a file of the dataset with this settings hash as `write_atomically`, unless another has taken its folder.

    Raises:
        DatagenError: `dataset.json` is gone, or is of other settings; nothing was written.
    """

    def check_settings() -> None:
        if _settings(folder) != settings:
            raise DatagenError(
                f"{folder / SPEC_FILE} is gone or belongs to another dataset by now; {name} was not written. "
                "Run the command again, perhaps with another --out."
            )

    write_atomically(folder / name, data, check=check_settings)


def _settings(folder: Path) -> str | None:
    """Settings hash of the folder's spec; None if it is missing or unreadable."""
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
    leads_nowhere = folder.is_symlink() and not folder.exists()
    if leads_nowhere or any(path.exists() and not path.is_dir() for path in (folder, *folder.parents)):
        raise UsageError(f"{folder} cannot be a folder: there is a file in its place; give another --out.")


def _remove_begun(folder: Path, begun: _Begun) -> None:
    """Remove what a failed run created, unless there are scenes or another process works there."""
    with suppress(OSError), closing(FolderLock(folder)) as lock:
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
    """Check that a folder without a spec holds no foreign files."""
    foreign = sorted(path.name for path in folder.iterdir() if target_name(path) == path.name)
    if foreign and not any(shard_settings(path) for path in _shards(folder)):
        raise UsageError(
            f"{folder} holds no dataset but {len(foreign)} other files ({', '.join(foreign[:3])}); "
            "give an empty or new folder with --out."
        )


def _goes_on(folder: Path, wanted: Spec, overwrite: bool) -> bool:
    """Whether the folder's dataset has the wanted settings or blocks them; otherwise a new one replaces it."""
    try:
        changed = bool(_changes(read_spec(folder), wanted))
    except CorruptFile:
        if not overwrite:
            raise
        if not any(shard_settings(path) for path in _shards(folder)):
            raise UsageError(
                f"{folder / SPEC_FILE} cannot be read, and no shard beside it proves that it is a dataset; "
                "delete it yourself, or give an empty or new folder with --out."
            ) from None
        changed = True
    # A run that was killed before its first shard leaves a spec alone, without a temporary file of a running process.
    is_bare = [path.name for path in _own_files(folder)] == [SPEC_FILE]
    return not changed or not (overwrite or is_bare)


def _changes(old: Spec, wanted: Spec) -> list[str]:
    """List the settings that differ; constants that are newer than a spec have their defaults."""
    complete = (
        {**spec, "recipe": recipe_to_dict(recipe_of(spec)), "compression": compression_of(spec)}
        for spec in (old, wanted)
    )
    return differences(*complete)


def _give_up(folder: Path, settings: str) -> None:
    """Delete our files except shards of these settings, and the spec, which another process may be writing."""
    kept = {path for path in _shards(folder) if shard_settings(path) == settings}
    for path in _own_files(folder):
        if path not in kept and target_name(path) != SPEC_FILE:
            path.unlink(missing_ok=True)


def _shards(folder: Path) -> list[Path]:
    return [path for path in _own_files(folder) if path.suffix == ".h5"]


def _own_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if _OURS.fullmatch(target_name(path)))
