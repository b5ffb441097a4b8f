"""Image files of a recording, sorted by the numbers in their names."""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from datagen.errors import UsageError

_SIGN = r"(?:(?<![^\W_])(?<!-)[-+])?"
"""Optional sign; after a letter, a digit or another dash, it is punctuation."""
_INTEGER = "[0-9]+"
_DECIMAL = r"(?<![0-9]\.)[0-9]+\.[0-9]+(?![0-9]|\.[0-9])"
"""Decimal number: two integers around a dot; three integers are a date or a version."""
_EXPONENT = r"(?:[eE][-+][0-9]{1,3}(?![^\W_]))?"
"""Optional exponent, always with a sign, as Python prints it: 1e-05."""
_NUMBER = re.compile(f"({_SIGN}(?:{_DECIMAL}|{_INTEGER}){_EXPONENT})")
_SIGNED_INTEGER = re.compile(f"({_SIGN}{_INTEGER})")

_STAMP = re.compile(r"(?<![0-9.])[0-9]{9,19}(?:\.[0-9]+)?(?![0-9.])")
"""Time since 1970 in a unit between seconds and nanoseconds."""

_Key = tuple[str | Decimal, ...]
"""Sort key: alternating text and numbers of a file name, starting with text."""


def list_frames(paths: Sequence[Path], endings: Sequence[str], flag: str) -> list[Path]:
    """List frames in time order: files as given, or the files of one folder, sorted by name.

    Ignores subfolders and hidden files, such as the `._0.png` that macOS writes.

    `endings` are those of frames in a folder, in lower case; `flag` names the paths in messages.

    Raises:
        UsageError: there are no files, or one does not exist.
    """
    if not paths:
        raise UsageError(f"{flag} names no files; give images in time order, or one folder of them.")
    folder = paths[0] if len(paths) == 1 and paths[0].is_dir() else None
    found = paths if folder is None else [path for path in folder.iterdir() if path.suffix.lower() in endings]
    if folder is not None:
        found = [path for path in found if not path.name.startswith(".") and not path.is_dir()]
    if not found:
        raise UsageError(f"{flag} {folder}: the folder holds no {', '.join(endings)}.")
    for path in found:
        if not path.exists():
            raise UsageError(f"{flag} {path} does not exist{', it is a broken link' if path.is_symlink() else ''}.")
    return list(paths) if folder is None else sort_frames(found)


def sort_frames(paths: Sequence[Path]) -> list[Path]:
    """Sort files by the numbers and the text in their names: 2.png before 10.png, and 0.25.png before 0.5.png.

    Numbers may be decimal, negative, or have an exponent. If both 1.1 and 1.10 occur, the dot separates integers.
    """
    split = _splitter(paths)
    return sorted(paths, key=lambda path: (_key(path, split), path.name))


def pair_frames(colours: Sequence[Path], partners: Sequence[Path], kind: str, place: Path) -> list[Path | None]:
    """Find the partner of each colour image: by time if all names are time stamps, otherwise in order.

    Images without a partner of about their time get None. `kind` names the partners in messages.

    Raises:
        UsageError: the numbers of images differ, or as `check_pairs`.
    """
    times, others = _times(colours), _times(partners)
    if times and others:
        return [None if near is None else partners[near] for near in nearest_times(times, others)]
    if len(colours) != len(partners):
        found = partners[0].parent if partners else place
        names = {path.stem for path in partners}
        alone = [path.name for path in colours if path.stem not in names]
        first = f"; {alone[0]} has none" if 0 < len(alone) < len(colours) else ""
        raise UsageError(
            f"{place} has {len(colours)} colour images but {len(partners)} {kind} in {found}{first}; "
            "expected one for each. Add the missing ones, or remove the images without a partner."
        )
    if len(colours) > 1:
        check_pairs(colours, partners)
    return list(partners)


def pair_masks(colours: Sequence[Path], masks: Sequence[Path], place: Path) -> list[Path | None]:
    """Find the mask of each colour image like `pair_frames`; without times, the names have to agree, too.

    Names agree if they hold the same numbers or, without numbers, if the mask's name contains that of the image.

    Raises:
        UsageError: as `pair_frames`, or a mask has a name of its own.
    """
    found = pair_frames(colours, masks, "masks", place)
    if len(colours) > 1 and not (_times(colours) and _times(masks)):
        for colour, mask in zip(colours, masks, strict=True):
            numbers = [_key(path, _SIGNED_INTEGER)[1::2] for path in (colour, mask)]
            if numbers[0] != numbers[1] or not (numbers[0] or colour.stem in mask.stem):
                raise UsageError(
                    f"{mask} would be the mask of {colour}, but their names do not agree; expected the image's number "
                    "or name in that of its mask. Rename the masks, or leave them out with --ignore-masks."
                )
    return found


def nearest_times(times: Sequence[float], others: Sequence[float]) -> list[int | None]:
    """Find the other time that is nearest to each time; None where that is nearer to another one of `times`.

    Pairs are at most half the median interval of `times` apart.
    """
    own, other = (np.array(values, np.float64)[:, None] for values in (times, others))
    distance, near = (np.asarray(found) for found in KDTree(other).query(own))
    back = np.asarray(KDTree(own).query(other)[1])
    most = np.median(np.diff(np.sort(own[:, 0]))) / 2 if len(own) > 1 else np.inf
    mutual = (back[near] == np.arange(len(own))) & (distance <= most)
    return [int(place) if paired else None for place, paired in zip(near, mutual, strict=True)]


def _times(paths: Sequence[Path]) -> list[float] | None:
    """Times in the names of files; None if a name has none."""
    found = [_STAMP.findall(path.stem) for path in paths]
    return [float(each[0]) for each in found] if all(len(each) == 1 for each in found) else None


def check_pairs(colours: Sequence[Path], depths: Sequence[Path]) -> None:
    """Check by the numbers in the names that the sorted files of two folders are the same frames.

    Names with few numbers in common, such as time stamps of two sensors, are paired in their order.

    Raises:
        UsageError: most numbers occur in both folders, but a pair has different ones, for example after a gap.
    """
    numbers = [_numbers(colours), _numbers(depths)]
    if 2 * len({*numbers[0]} & {*numbers[1]}) < len(colours):
        return
    for colour, depth, *pair in zip(colours, depths, *numbers, strict=True):
        if pair[0] != pair[1]:
            raise UsageError(
                f"{colour} and {depth} would be one frame, but their numbers differ; expected a depth image for each "
                "colour image. Remove files without a partner, or name all files in order instead of the folders."
            )


def _numbers(paths: Sequence[Path]) -> list[_Key]:
    """Numbers in the name of each file."""
    split = _splitter(paths)
    return [_key(path, split)[1::2] for path in paths]


def _splitter(paths: Sequence[Path]) -> re.Pattern[str]:
    """Decide whether dots are decimal points: not if two different names would be equal numbers."""
    names = {path.stem.casefold() for path in paths}
    distinct = len({_key(path, _NUMBER) for path in paths}) == len(names)
    return _NUMBER if distinct else _SIGNED_INTEGER


def _key(path: Path, split: re.Pattern[str]) -> _Key:
    parts = split.split(path.stem.casefold())
    return tuple(Decimal(part) if place % 2 else part for place, part in enumerate(parts))
