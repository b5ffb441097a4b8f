"""A dataset's folder: which files are ours, how they are written whole or not at all, and who may write."""

import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

from datagen.config import recipe_to_dict
from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.processes import is_running
from datagen.schema import SPLITS
from datagen.shard import Shard
from datagen.spec import (
    CARD_FILE,
    MANIFEST_FILE,
    SPEC_FILE,
    Spec,
    differences,
    read_spec,
    recipe_of,
    settings_hash,
    shard_name,
    spec_text,
    with_splits,
)

_OURS = re.compile(
    rf"({SPEC_FILE}|{MANIFEST_FILE}|{CARD_FILE}|preview\.\w+|({'|'.join(SPLITS)})-\d{{5,}}\.h5)(\.partial-.+)?"
)
_PARTIAL = re.compile(r".+\.partial-(?P<host>.+)-(?P<process>\d+)")
_ABANDONED_SECONDS = 3600


def begin(folder: Path, wanted: Spec, *, overwrite: bool = False, prove: Callable[[], object] = lambda: None) -> Spec:
    """Make a folder ready to be filled, and write its spec.

    A dataset of the same settings goes on, even where `overwrite` is set, so that the same command can be repeated.

    Args:
        folder: Where the dataset is or will be.
        wanted: Its spec.
        overwrite: Give up a dataset of other settings; scenes of the wanted ones stay.
        prove: Called before a dataset is begun; where it raises, what the folder holds stays as it is.

    Returns:
        The spec that holds from now on: as `wanted`, but with no fewer scenes than were asked for before.

    Raises:
        UsageError: the folder holds something else, or a dataset of other settings that `overwrite` does not give up.
        CorruptFile: a file that is there cannot be read.
        OSError: the folder cannot be made or written to.
    """
    _make(folder)
    _remove_abandoned(folder)
    if not _goes_on(folder, wanted, overwrite):
        prove()
    # Asked again, because another process may have begun the same dataset meanwhile.
    if _goes_on(folder, wanted, overwrite):
        return settle(folder, wanted)
    _give_up(folder, settings_hash(wanted))
    write_whole(folder / SPEC_FILE, spec_text(wanted).encode())
    return wanted


def settle(folder: Path, wanted: Spec) -> Spec:
    """Let the folder's spec have as many scenes as it has, as are wanted and as are there, whichever is most.

    Raises:
        UsageError: the folder holds a dataset of other settings.
        CorruptFile: a file that is there cannot be read.
    """
    old = read_spec(folder)
    if changed := _changes(old, wanted):
        raise UsageError(
            f"{folder} holds a dataset of other settings ({'; '.join(changed)}). "
            "Give another folder with --out, the same settings, or --overwrite to make it anew."
        )
    present = scenes_present(folder, old)
    most = {split: max(old["splits"][split], wanted["splits"][split], present[split]) for split in SPLITS}
    spec = with_splits(old, most)
    if spec != old:
        write_whole(folder / SPEC_FILE, spec_text(spec).encode())
    return spec


def write_whole(path: Path, data: bytes) -> None:
    """Write a file such that whoever looks sees all of it or nothing, even after a crash.

    Raises:
        DatagenError: it cannot be written, for example because the disk is full; what was there before is intact.
    """
    partial = path.with_name(f"{path.name}.partial-{socket.gethostname()}-{os.getpid()}")
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
        _sync_folder(path.parent)
    except OSError as error:
        raise DatagenError(
            f"Cannot write {path}: {error.strerror}. Finished files are intact; mend this and run the same command."
        ) from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def scenes_present(folder: Path, spec: Spec) -> dict[str, int]:
    """For each split the number of the last scene that is there, counted from 1."""
    return {split: _scenes_present(folder, split, spec["scenes_per_shard"]) for split in SPLITS}


def _scenes_present(folder: Path, split: str, per_shard: int) -> int:
    matches = (re.fullmatch(rf"{split}-(\d{{5,}})\.h5", path.name) for path in folder.iterdir())
    last = max((int(match[1]) for match in matches if match), default=None)
    if last is None:
        return 0
    with closing(Shard(folder / shard_name(split, last))) as shard:
        return last * per_shard + len(shard)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise UsageError(f"{folder} cannot be a folder: there is a file in its place; give another --out.") from None
    if (folder / SPEC_FILE).exists():
        with suppress(CorruptFile):
            read_spec(folder)
    elif foreign := sorted(path.name for path in folder.iterdir() if path not in set(_partials(folder))):
        raise UsageError(
            f"{folder} holds no dataset but {len(foreign)} other files ({', '.join(foreign[:3])}); "
            "give an empty or new folder with --out."
        )


def _goes_on(folder: Path, wanted: Spec, overwrite: bool) -> bool:
    """Whether the folder's dataset is the wanted one, or one that stands in its way; else a new one is begun."""
    if not (folder / SPEC_FILE).exists():
        return False
    try:
        changed = bool(_changes(read_spec(folder), wanted))
    except CorruptFile:
        if not overwrite:
            raise
        _check_ours(folder)
        changed = True
    # A spec alone is what a run leaves behind that failed before its first shard.
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
    if not any(_shard_settings(path) for path in _shards(folder)):
        raise UsageError(
            f"{folder / SPEC_FILE} cannot be read, and there is no shard beside it that tells whose it is; "
            "delete it yourself, or give an empty or new folder with --out."
        )


def _give_up(folder: Path, settings: str) -> None:
    """Delete our files, except for the spec, which someone may be writing right now, and shards of these settings."""
    kept = {path for path in _shards(folder) if _shard_settings(path) == settings}
    for path in _own_files(folder):
        if path not in kept and not path.name.startswith(SPEC_FILE):
            path.unlink(missing_ok=True)


def _shard_settings(path: Path) -> str | None:
    """The settings' hash of a shard, None where it cannot be read."""
    try:
        with closing(Shard(path)) as shard:
            return str(shard.attributes["settings_hash"])
    except DatagenError:
        return None


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
