"""Image files of a recording, ordered by the numbers in their names."""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path

from obpose.errors import UsageError

_SIGN = r"(?:(?<![^\W_])(?<!-)[-+])?"
"""Pattern of an optional sign; after a letter, a digit or another dash it is punctuation instead."""
_WHOLE = "[0-9]+"
_DECIMAL = r"(?<![0-9]\.)[0-9]+\.[0-9]+(?![0-9]|\.[0-9])"
"""Pattern of a decimal: two whole numbers around a dot. Three are a date or a version instead."""
_EXPONENT = r"(?:[eE][-+][0-9]{1,3}(?![^\W_]))?"
"""Pattern of an optional exponent, always with a sign, as Python prints it: 1e-05."""
_NUMBER = re.compile(f"({_SIGN}(?:{_DECIMAL}|{_WHOLE}){_EXPONENT})")
_NUMBER_OF_PARTS = re.compile(f"({_SIGN}{_WHOLE})")

_Key = tuple[str | Decimal, ...]
"""Sort key: text and numbers of a file name in turn, beginning with text."""


def list_frames(paths: Sequence[Path], endings: Sequence[str], flag: str) -> list[Path]:
    """List the files that a flag names, in time order: as given, or those of one folder, sorted by name.

    Hidden files, such as the `._0.png` that macOS writes, and folders inside the folder are not frames.

    Args:
        paths: Files, or one folder.
        endings: File endings of frames in a folder, in lower case.
        flag: The flag that named them, for messages.

    Raises:
        UsageError: there are no files, or one does not exist.
    """
    if not paths:
        raise UsageError(f"{flag} names no files; give images in time order, or one folder of them.")
    folder = paths[0] if len(paths) == 1 and paths[0].is_dir() else None
    found = paths if folder is None else [path for path in folder.iterdir() if _is_frame(path, endings)]
    if not found:
        raise UsageError(f"{flag} {folder}: the folder holds no {', '.join(endings)}.")
    for path in found:
        if not path.exists():
            raise UsageError(f"{flag} {path} does not exist{', it is a broken link' if path.is_symlink() else ''}.")
    return list(paths) if folder is None else sort_frames(found)


def sort_frames(paths: Sequence[Path]) -> list[Path]:
    """Sort files by the numbers and the text in their names: 2.png before 10.png, and 0.25.png before 0.5.png.

    Numbers may be decimals, negative, or have an exponent. Where 1.1 and 1.10 are both names, the dot separates whole
    numbers.
    """
    split = _splitter(paths)
    return sorted(paths, key=lambda path: (_key(path, split), path.name))


def check_pairs(colours: Sequence[Path], depths: Sequence[Path]) -> None:
    """Check that the sorted files of two folders are the same frames, where their numbers tell.

    Names whose numbers have little in common, such as time stamps of two sensors, are paired in their order.

    Raises:
        UsageError: most numbers are in both folders, but a pair has different ones, as where a frame is missing.
    """
    numbers = [[_numbers(path, _splitter(paths)) for path in paths] for paths in (colours, depths)]
    if 2 * len({*numbers[0]} & {*numbers[1]}) < len(colours):
        return
    for colour, depth, *pair in zip(colours, depths, *numbers, strict=True):
        if pair[0] != pair[1]:
            raise UsageError(
                f"{colour} and {depth} would be one frame, but their numbers differ; expected a depth image for each "
                "colour image. Remove files without a partner, or name all files in order instead of the folders."
            )


def _is_frame(path: Path, endings: Sequence[str]) -> bool:
    return path.suffix.lower() in endings and not path.name.startswith(".") and not path.is_dir()


def _splitter(paths: Sequence[Path]) -> re.Pattern[str]:
    """Find out whether dots between digits are decimal points: not if two different names would be equal numbers."""
    names = {path.stem.casefold() for path in paths}
    distinct = len({_key(path, _NUMBER) for path in paths}) == len(names)
    return _NUMBER if distinct else _NUMBER_OF_PARTS


def _key(path: Path, split: re.Pattern[str]) -> _Key:
    parts = split.split(path.stem.casefold())
    return tuple(Decimal(part) if place % 2 else part for place, part in enumerate(parts))


def _numbers(path: Path, split: re.Pattern[str]) -> _Key:
    return _key(path, split)[1::2]
