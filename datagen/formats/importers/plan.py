"""From recordings to scenes: which images form a scene, and in which split it goes."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from datagen.console.text import counted
from datagen.errors import UsageError
from datagen.formats.import_request import Request
from datagen.formats.importers.interface import Facts, Recording
from datagen.rgbd.images import Size
from datagen.schema import SPLITS
from datagen.storage.spec import MOST_PIXELS

MOST_OBJECTS = 255
"""Most objects of a scene: ids are bytes."""
ASSUMED_OBJECTS = 6
"""Most objects of a scene if there are no masks; models take their number of slots from it."""
_SHARES = 10
_FEW = 3
"""Recordings from which on whole recordings are assigned to splits."""

Surveyed = tuple[Recording, Facts]


@dataclass(frozen=True)
class Unit:
    """Images of a recording that become one scene."""

    recording: Recording
    facts: Facts
    images: tuple[int, ...]

    @property
    def name(self) -> str:
        """Place of its files, for messages."""
        whole = len(self.images) == self.facts.images
        return self.recording.name + ("" if whole else f", images from {self.images[0]} on")


@dataclass(frozen=True)
class Plan:
    """Scenes of a dataset before their images are read."""

    units: dict[str, list[Unit]]
    """Scenes of each split."""
    frames: int
    views: int
    size: Size
    objects: int
    """Upper bound of the number of objects."""
    notes: tuple[str, ...]


def enough(recordings: Sequence[Recording], scenes: int | None) -> list[Recording]:
    """As many recordings as a number of scenes in each split needs, so that large datasets are not read whole."""
    if scenes is None:
        return list(recordings)
    taken: Counter[str | None] = Counter()
    chosen = []
    for recording in recordings:
        taken[recording.split] += 1
        # Without published splits, one scene of ten goes to test.
        if taken[recording.split] <= scenes * (1 if recording.split else _SHARES):
            chosen.append(recording)
    return chosen


def plan_scenes(recordings: Iterable[Surveyed], request: Request) -> Plan:
    """Group the images of recordings into scenes of one form, and assign them to splits.

    Raises:
        UsageError: the scenes would differ in size or number of images, are too large, or mix masks with none in a
            split.
    """
    surveyed = list(recordings)
    (first, facts), *others = surveyed
    for other, more in others:
        if more.size != facts.size and not request.size:
            raise UsageError(
                f"{other.name} has images of {more.size[0]}x{more.size[1]} pixels, {first.name} of {facts.size[0]}x"
                f"{facts.size[1]}; all scenes need one size. Give --resolution, such as 160x120: images are cropped to "
                "its aspect and scaled."
            )
        if more.views != facts.views:
            raise UsageError(
                f"{other.name} has {counted(more.views, 'view')}, {first.name} {facts.views}; all scenes need equal "
                "numbers. Import them into several datasets."
            )
    size, cameras = request.size or facts.size, facts.views
    groups = {recording: _groups(recording, facts, request) for recording, facts in surveyed}
    lengths = {len(images): recording for recording, parts in groups.items() for images in parts}
    if len(lengths) > 1:
        (one, shorter), (other, longer) = sorted(lengths.items(), key=lambda item: item[0])[:2]
        flag = "--views" if request.group == "views" else "--frames"
        raise UsageError(
            f"{shorter.name} has {counted(one, 'image')} and {longer.name} {other}; all scenes need equal numbers. "
            f"Give {flag} {one} to take as many of each, or --group stills for a scene an image."
        )
    length = next(iter(lengths))
    frames, views = (1, length) if request.group == "views" else (length, cameras)
    if frames * views * size[0] * size[1] > MOST_PIXELS:
        raise UsageError(
            f"A scene would have {frames * views} images of {size[0]}x{size[1]}; expected at most "
            f"{MOST_PIXELS:,} pixels. Give fewer --frames or --views, or a smaller --resolution."
        )
    units, notes = _assign(
        [[Unit(recording, facts, images) for images in groups[recording]] for recording, facts in surveyed], request
    )
    for split, members in units.items():
        _check_masks(split, members)
    bounds = [unit.facts.objects for members in units.values() for unit in members if unit.facts.objects is not None]
    wanted = max(bounds, default=ASSUMED_OBJECTS) if request.objects is None else request.objects
    # A recording with many objects may show few of them at a time; scenes with too many are refused when they are read.
    objects = min(max(1, wanted, *bounds), MOST_OBJECTS)
    return Plan(units, frames, views, size, objects, notes)


def _groups(recording: Recording, facts: Facts, request: Request) -> list[tuple[int, ...]]:
    """Numbers of the images of each scene of a recording."""
    if request.group == "stills":
        return [(image,) for image in range(facts.images)]
    wanted = request.views if request.group == "views" else request.frames
    length = wanted or facts.images
    if length > facts.images:
        flag = "--views" if request.group == "views" else "--frames"
        raise UsageError(f"{recording.name} has {counted(facts.images, 'image')}, but {flag} is {length}; give fewer.")
    if request.group == "views":
        return [tuple(place * facts.images // length for place in range(length))]
    return [tuple(range(start, start + length)) for start in range(0, facts.images - length + 1, length)]


def _assign(groups: list[list[Unit]], request: Request) -> tuple[dict[str, list[Unit]], tuple[str, ...]]:
    """Units of each split, and notes on how they were chosen."""
    units = [unit for members in groups for unit in members]
    labelled = [unit.facts.objects is not None for unit in units]
    notes: tuple[str, ...] = ()
    if any(labelled) and not all(labelled) and (request.split or not all(unit.recording.split for unit in units)):
        places, kept = iter(range(len(units))), (request.split,) * 2 if request.split else ("test", "val")
        splits = [kept[next(places) % 2] if known else "train" for known in labelled]
        given = f"are split {request.split}" if request.split else "are shared between test and val"
        notes = (f"Scenes without masks are the training split; those with masks {given}.",)
    elif request.split:
        splits = [request.split] * len(units)
    elif all(unit.recording.split for unit in units):
        splits = [str(unit.recording.split) for unit in units]
    elif len(groups) >= _FEW or len(units) == len(groups):
        splits = [_share(place) for place, members in enumerate(groups) for _ in members]
    else:
        splits = [_share(place) for place in range(len(units))]
        notes = ("Training, validation and test scenes come from the same recordings.",)
    found = {name: [unit for unit, split in zip(units, splits, strict=True) if split == name] for name in SPLITS}
    published = all(unit.recording.split for unit in units)
    if not (request.split or published) and (empty := [name for name, members in found.items() if not members]):
        notes = (*notes, _note_on_empty(empty))
    return {name: members[: request.scenes] for name, members in found.items()}, notes


def _note_on_empty(splits: Sequence[str]) -> str:
    return (
        f"No scenes for {' and '.join(splits)}. To get some, import more recordings, cut them into clips with --frames "
        "N, or make each image a scene with --group stills. --split test puts all scenes into test."
    )


def _share(place: int) -> str:
    """Split of one of many scenes: of every ten, the second goes to test, the third to val, the others to train."""
    return {1: "test", 2: "val"}.get(place % _SHARES, "train")


def _check_masks(split: str, units: Sequence[Unit]) -> None:
    known = {unit.facts.objects is not None: unit for unit in units}
    if len(known) > 1:
        raise UsageError(
            f"{known[True].recording.name} has masks and {known[False].recording.name} has none, but all scenes of "
            f"split {split} need the same fields. Leave out --split, move them to train/, val/ and test/, or leave "
            "masks out with --ignore-masks."
        )
