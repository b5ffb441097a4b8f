"""Import a dataset of another project into a new dataset folder, which appears only when it is complete."""

import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from datagen.console.progress import Progress, no_progress
from datagen.errors import UsageError
from datagen.formats.import_request import Request
from datagen.formats.importers import IMPORTERS
from datagen.formats.importers.convert import Measured, Target, convert, fields_of
from datagen.formats.importers.plan import Plan, Unit, enough, plan_scenes
from datagen.inspect.dataset_card import write_card
from datagen.schema import SPLITS
from datagen.storage.atomic import new_folder, write_atomically
from datagen.storage.manifest import file_facts, make_manifest
from datagen.storage.shard import pack, shard_image
from datagen.storage.spec import (
    MANIFEST_FILE,
    SPEC_FILE,
    Spec,
    make_imported_spec,
    settings_hash,
    shard_name,
    shard_ranges,
    spec_text,
)

FPS = 10.0
"""Frames per second of clips that do not say theirs; it only matters for animations."""


@dataclass(frozen=True)
class Report:
    """Result of an import."""

    spec: Spec
    seconds: float
    measured: list[Measured]
    notes: tuple[str, ...]


def import_dataset(request: Request, *, progress: Progress = no_progress) -> Report:
    """Import a dataset.

    Raises:
        UsageError: the source does not have the layout of the format, its scenes differ in form, or the target is not
            empty; nothing was written.
        CorruptFile: a file is damaged; nothing was written.
        DatagenError: the dataset cannot be written, for example because the disk is full.
    """
    started = time.monotonic()
    with new_folder(request.out) as folder:
        # Find the recordings.
        with _reading():
            found = IMPORTERS[request.format](request.source, request.reading)
        group = request.group or found.grouping
        recordings = enough(found.recordings, request.scenes)
        # Survey all of them, so that nothing is converted in vain.
        with progress(len(recordings)) as advance:
            surveyed = []
            for recording in recordings:
                with _reading():
                    surveyed.append((recording, recording.survey()))
                advance()
        # Convert them, split by split.
        plan = plan_scenes(surveyed, replace(request, group=group))
        target = Target(group, plan.size, plan.objects, request.world)
        fields = {split: _fields(plan, split) for split in SPLITS}
        spec = _spec(request, plan, fields, found.recordings[0].fps)
        measured: list[Measured] = []
        with progress(sum(map(len, plan.units.values()))) as advance:
            for split in SPLITS:
                for measures in _write_split(folder, spec, split, plan, target, frozenset(fields[split])):
                    measured.append(measures)
                    advance()
        _finish(folder, spec, time.monotonic() - started, len(measured))
    return Report(spec, time.monotonic() - started, measured, (*found.notes, *plan.notes))


def _fields(plan: Plan, split: str) -> tuple[str, ...]:
    """Fields of the scenes of a split, which are those of its first scene."""
    if not plan.units[split]:
        return ()
    first = plan.units[split][0]
    with _reading():
        return fields_of(first.recording.read(first.images[:1]))


def _spec(request: Request, plan: Plan, fields: Mapping[str, tuple[str, ...]], fps: float | None) -> Spec:
    reading = {name: str(value) if isinstance(value, Path) else value for name, value in vars(request.reading).items()}
    if not reading["predicted_masks"]:
        del reading["predicted_masks"]  # datasets from before this choice existed keep their identity
    source = _printable(request.source.resolve().name or str(request.source))
    origin: dict[str, Any] = {
        "format": request.format,
        "source": source,
        "world": " or ".join(sorted(_worlds(request, plan))),
        "grouping": request.group,
        **reading,
    }
    if request.format == "rgbd":
        origin["recordings"] = {
            split: [_printable(Path(unit.name).name) for unit in units] for split, units in plan.units.items()
        }
    facts = {
        "name": f"{request.format}-import",
        "description": f"Imported from {source}, format {request.format}.",
        "frames": plan.frames,
        "views": plan.views,
        "resolution": plan.size,
        "fps": request.fps or fps or FPS,
        "parts": [],
        "objects": {"maximum": plan.objects},
        "sensor": {"enabled": False},
    }
    splits = {split: len(units) for split, units in plan.units.items()}
    return make_imported_spec(origin, facts, splits=splits, resolution=plan.size, fields=fields)


def _worlds(request: Request, plan: Plan) -> set[str]:
    """Origins of the world frames: `given` poses, or the `table` that the first image shows."""
    posed = {unit.facts.posed for units in plan.units.values() for unit in units}
    return {"given" if known and request.world != "table" else "table" for known in posed}


def _printable(name: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in name[:200])


def _write_split(
    folder: Path, spec: Spec, split: str, plan: Plan, target: Target, fields: frozenset[str]
) -> Iterator[Measured]:
    """Write the shards of a split; yields the measures of each scene."""
    units = plan.units[split]
    for number, indices in enumerate(shard_ranges(len(units), spec["scenes_per_shard"])):
        scenes = []
        for index in indices:
            record, measured = _read(units[index], target, fields)
            scenes.append(pack(record))
            yield measured
        attributes = {
            "data_version": spec["data_version"],
            "generator": spec["generator"],
            "settings_hash": settings_hash(spec),
            "split": split,
            "first_scene": indices.start,
        }
        write_atomically(folder / shard_name(split, number), shard_image(scenes, attributes))


def _read(unit: Unit, target: Target, fields: frozenset[str]) -> tuple[dict[str, np.ndarray], Measured]:
    with _reading():
        images = unit.recording.read(unit.images)
    return convert(images, target, unit.name, fields)


@contextmanager
def _reading() -> Iterator[None]:
    """Name files that the system cannot read, such as those of other users; `new_folder` would blame its target."""
    try:
        yield
    except OSError as error:
        place = f"{error.filename} " if error.filename else "The source "
        raise UsageError(f"{place}cannot be read: {error.strerror or error}. Fix this, or remove it.") from None


def _finish(folder: Path, spec: Spec, seconds: float, scenes: int) -> None:
    write_atomically(folder / SPEC_FILE, spec_text(spec).encode())
    write_card(folder)
    manifest = make_manifest(spec, file_facts(folder, spec), seconds=seconds, workers=1, scenes_made=scenes)
    write_atomically(folder / MANIFEST_FILE, (json.dumps(manifest, indent=2) + "\n").encode())
